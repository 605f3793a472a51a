// Output of finished pixels. Outputs that were not asked for are neither computed nor written.

layout(constant_id = 0) const bool COLOR_U8 = false;       // RGBA8, clamped and rounded, instead of 4 x f32

layout(set = 0, binding = 0, scalar) readonly buffer cameras_block { Camera cameras[]; };
#include "camera_of_bin.glsl"
#include "planes.glsl"
layout(set = 0, binding = 1, std430) writeonly buffer images_f32_block { vec4 images_f32[]; };
layout(set = 0, binding = 3, std430) writeonly buffer images_u8_block { uint images_u8[]; };

// Assignment of a coarse tile's pixels to lanes in blend: eight lanes have a block of 4 x 4, two
// pixels each, and four blocks are a fine tile. A pixel's index counts the left pixels of all
// lanes first, then the right ones, two columns beside them.
const uint LEFT_PIXELS = COARSE_PIXELS / 2u;
const uint TILE_LEFT_PIXELS = FINE_TILE_PX * FINE_TILE_PX / 2u;

// The fine tile, row-major in its coarse tile, of the pixel at `index`.
uint fine_tile(uint index) {
    return index % LEFT_PIXELS / TILE_LEFT_PIXELS;
}

// Position in the coarse tile of the pixel at `index`.
uvec2 pixel_offset(uint index) {
    uint tile = fine_tile(index);
    uint block = index / 8u % 4u;
    uint lane = index % 8u;
    uvec2 in_block = uvec2(lane % 2u + 2u * (index / LEFT_PIXELS), lane / 2u);
    return uvec2(tile % COARSE_COLUMNS, tile / COARSE_COLUMNS) * FINE_TILE_PX + uvec2(block % 2u, block / 2u) * 4u + in_block;
}

// Transmittance limit of the exclusive stop: a pixel stops before the splat that would take its
// transmittance to this or below.
const float TRANSMITTANCE_MIN = 1e-4;

// Transmittance limit of the inclusive stop: a pixel stops behind the splat that takes its
// transmittance to this or below.
const float TRANSMITTANCE_MIN_INCLUSIVE = 1e-3;

// Transmittance at which half of the light is gone: medians are of the splat that leaves no more.
const float TRANSMITTANCE_MEDIAN = 0.5;

// Elsewhere it stops once no more than this is left: the rules allow an error of 1e-4, and 95 dB do
// not.
const float TRANSMITTANCE_FULL = 2e-5;

// Accumulated color and transmittance of a pixel, front to back.
struct Pixel {
    vec3 color;
    float transmittance;
    PlaneSums planes;
    uint median; // record in which half of the light is gone, once no more than that is left
};

const Pixel PIXEL_EMPTY = Pixel(vec3(0.0), 1.0, PLANES_EMPTY, 0u);

// Top left pixel of a coarse tile.
uvec2 coarse_tile_origin(uint bin, Camera camera) {
    uint tile = bin - camera.first_bin;
    return uvec2(tile % camera.coarse_tiles.x * COARSE_WIDTH_PX, tile / camera.coarse_tiles.x * COARSE_HEIGHT_PX);
}

// Writes the pixel at `at` of the image of `camera`, one of images of `image_pixels` in all.
void write_pixel(Camera camera, uvec2 at, Pixel pixel, vec3 sky, uint image_pixels) {
    if (any(greaterThanEqual(at, camera.size_px))) {
        return;
    }
    uint index = camera.first_pixel + at.y * camera.size_px.x + at.x;
    float alpha = 1.0 - pixel.transmittance;
    vec4 value = vec4(pixel.color + pixel.transmittance * sky, alpha);
    if (COLOR_U8) {
        images_u8[index] = packUnorm4x8(value);
    } else {
        images_f32[index] = value;
    }
    write_planes(index, image_pixels, alpha, pixel.planes);
}

// Writes the medians of the pixel at `at` of the image of `camera`, with the depth and the range of
// the splat in which half of its light is gone, or zeros.
void write_medians(Camera camera, uvec2 at, vec2 depth_and_range_m, uint image_pixels) {
    if (all(lessThan(at, camera.size_px))) {
        write_medians_at(camera.first_pixel + at.y * camera.size_px.x + at.x, image_pixels, depth_and_range_m);
    }
}

// The pixel after `nearer`, then `farther` behind it. Its median is that of `nearer`.
Pixel over(Pixel nearer, Pixel farther) {
    float share = nearer.transmittance;
    nearer.color += share * farther.color;
    nearer.transmittance *= farther.transmittance;
    nearer.planes = planes_over(nearer.planes, share, farther.planes);
    return nearer;
}
