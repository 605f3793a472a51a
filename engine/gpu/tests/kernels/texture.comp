#version 460
// Binds something that is no storage buffer: refused.
layout(local_size_x = 1) in;
layout(binding = 0, rgba8) uniform writeonly image2D picture;

void main() {
    imageStore(picture, ivec2(0), vec4(1.0));
}
