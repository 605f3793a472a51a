#version 460
// Writes indirect arguments for push.count invocations in groups of push.group_size, at word
// push.first_word.
#extension GL_EXT_scalar_block_layout : require
layout(local_size_x = 1) in;
layout(scalar, binding = 0) buffer Arguments { uint words[]; } arguments;
layout(scalar, push_constant) uniform Push { uint count; uint group_size; uint first_word; } push;

void main() {
    arguments.words[push.first_word] = (push.count + push.group_size - 1) / push.group_size;
    arguments.words[push.first_word + 1] = 1;
    arguments.words[push.first_word + 2] = 1;
}
