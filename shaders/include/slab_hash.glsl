// Pairs of a workgroup, added up by coarse tile and depth slab before they are added to
// `slab_counts`: neighbors in the list of records are neighbors in the scene, so that many have the
// same.
//
// A hash table in shared memory, a slot per thread. What finds no place in it is added by itself.

const uint HASH_BITS = 8u;
const uint HASH_SLOTS = 1u << HASH_BITS; // PAIR_BLOCK
const uint NO_SLAB = 0xffffffffu;
const uint NO_SLOT = 0xffffffffu;

shared uint hash_slabs[HASH_SLOTS];  // index in slab_counts, or NO_SLAB
shared uint hash_counts[HASH_SLOTS]; // its pairs

// A barrier must follow.
void empty_hash(uint thread) {
    hash_slabs[thread] = NO_SLAB;
    hash_counts[thread] = 0u;
}

// The slot of a slab, or NO_SLOT if two others have taken its places.
uint slot_of(uint slab) {
    uint slot = slab * 2654435769u >> (32u - HASH_BITS);
    uint holder = atomicCompSwap(hash_slabs[slot], NO_SLAB, slab);
    if (holder == NO_SLAB || holder == slab) {
        return slot;
    }
    slot ^= 1u;
    holder = atomicCompSwap(hash_slabs[slot], NO_SLAB, slab);
    return holder == NO_SLAB || holder == slab ? slot : NO_SLOT;
}
