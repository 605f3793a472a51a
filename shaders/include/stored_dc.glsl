// The DC coefficients of a splat of the background as they are stored.
vec3 load_dc(uint splat_index) {
    if (COMPACT) {
        uint words[2] = uint[2](sh_dc[splat_index], sh_dc[splat_count + splat_index]);
        return sh_step(words[0], 7, 19) * SH_COEFFICIENT(words, 0, 7, 19);
    }
    uint first = 3u * splat_index;
    return uintBitsToFloat(uvec3(sh_dc[first], sh_dc[first + 1u], sh_dc[first + 2u]));
}
