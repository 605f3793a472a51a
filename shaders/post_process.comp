#version 460
// Post-processing of an image: the sky map behind the splats is added, the photometric calibration
// of the camera applied, and color written as asked.
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_scalar_block_layout : require
#include "frame.glsl"
#include "turn.glsl"

layout(local_size_x = 256) in;

layout(constant_id = 0) const bool COLOR_U8 = false; // RGBA8, clamped and rounded, instead of 4 x f32
layout(constant_id = 1) const bool SKY = false;      // there is a sky map
layout(constant_id = 2) const bool LENS = false;     // rays come from a table: the camera is no pinhole

layout(set = 0, binding = 0, scalar) readonly buffer cameras_block { Camera cameras[]; };
layout(set = 0, binding = 1, std430) readonly buffer blended_block { vec4 blended[]; }; // color of the splats, and alpha
layout(set = 0, binding = 2, scalar) readonly buffer rays_block { vec3 rays[]; };       // per pixel, camera frame; zero where there is none
layout(set = 0, binding = 3, scalar) readonly buffer sky_texels_block { vec3 sky_texels[]; }; // six faces with borders of one texel
// See `Photometry` in the engine.
struct Photometry {
    vec3 matrix[3]; // rows of red, green and blue
    vec3 offset;
    vec3 gamma;
    vec3 vignetting[3]; // coefficients of r^2, r^4 and r^6, each of red, green and blue
    vec2 vignetting_center_px[3]; // of red, green and blue
    vec2 vignetting_scale; // r is 1 where a distance from the center times this is
    float gain;
    vec3 balance[3];  // rows of the homography of red, green and their sum with blue
    vec3 response[5]; // exponents below and above the center and of the whole, center, value there; each of red, green and blue
    uint has_gamma;
    uint has_balance;
    uint has_response;
};

layout(set = 0, binding = 4, scalar) readonly buffer photometry_block { Photometry photometry[]; }; // per camera
layout(set = 0, binding = 5, std430) writeonly buffer images_f32_block { vec4 images_f32[]; };
layout(set = 0, binding = 6, std430) writeonly buffer images_u8_block { uint images_u8[]; };

// Rotation from the camera to the cube, by columns; light that fog adds to the sky, and the share
// that it leaves of it.
layout(push_constant, scalar) uniform push_block { vec3 right; vec3 down; vec3 forward; uint camera; uint face_texels; uint clamps_sky; uint clamps_splats; vec4 fog; };

// Color of the sky in a direction of its cube, of any length but zero: see `SkyMap` in the engine.
vec3 sky_color(vec3 direction) {
    vec3 size = abs(direction);
    float longest = max(size.x, max(size.y, size.z));
    uint face;
    vec2 at;
    if (size.x == longest) {
        face = direction.x > 0.0 ? 0u : 1u;
        at = vec2(direction.x > 0.0 ? -direction.z : direction.z, -direction.y);
    } else if (size.y == longest) {
        face = direction.y > 0.0 ? 2u : 3u;
        at = vec2(direction.x, direction.y > 0.0 ? direction.z : -direction.z);
    } else {
        face = direction.z > 0.0 ? 4u : 5u;
        at = vec2(direction.z > 0.0 ? direction.x : -direction.x, -direction.y);
    }
    // The center of texel 0 is 1 in the face with its border.
    vec2 texel = 0.5 * (at / longest + 1.0) * float(face_texels) + 0.5;
    vec2 first = min(floor(texel), vec2(float(face_texels)));
    vec2 share = texel - first;
    uint side = face_texels + 2u;
    uint corner = (face * side + uint(first.y)) * side + uint(first.x);
    vec3 upper = mix(sky_texels[corner], sky_texels[corner + 1u], share.x);
    vec3 lower = mix(sky_texels[corner + side], sky_texels[corner + side + 1u], share.x);
    vec3 color = mix(upper, lower, share.y);
    return (clamps_sky != 0u ? clamp(color, 0.0, 1.0) : color) * fog.a + fog.rgb;
}

// Response of the sensor to light from 0 to 1: see `Response` in the engine.
vec3 responded(Photometry own, vec3 light) {
    vec3 toe = own.response[0];
    vec3 shoulder = own.response[1];
    vec3 center = own.response[3];
    vec3 at_center = own.response[4];
    vec3 below = at_center * pow(max(light / center, 1e-6), toe);
    vec3 above = 1.0 - (1.0 - at_center) * pow(max((1.0 - light) / (1.0 - center), 1e-6), shoulder);
    vec3 joined = mix(above, below, lessThanEqual(light, center));
    return pow(max(joined, 1e-6), own.response[2]);
}

// Color of the image at `center_px` of a color of the scene.
vec3 calibrated(vec3 color, vec2 center_px) {
    Photometry own = photometry[camera];
    vec3 r2;
    for (uint channel = 0u; channel < 3u; ++channel) {
        vec2 at = (center_px - own.vignetting_center_px[channel]) * own.vignetting_scale;
        r2[channel] = dot(at, at);
    }
    vec3 through = clamp(1.0 + r2 * (own.vignetting[0] + r2 * (own.vignetting[1] + r2 * own.vignetting[2])), 0.0, 1.0);
    vec3 exposed = own.gain * color * through;
    if (own.has_balance != 0u) {
        float sum = exposed.r + exposed.g + exposed.b;
        vec3 of = vec3(exposed.rg, sum);
        vec3 turned = vec3(dot(own.balance[0], of), dot(own.balance[1], of), dot(own.balance[2], of));
        float divisor = turned.b + 1e-5;
        turned *= divisor > 0.0 ? sum / divisor : 0.0;
        exposed = vec3(turned.rg, turned.b - turned.r - turned.g);
    }
    vec3 mixed = vec3(dot(own.matrix[0], exposed), dot(own.matrix[1], exposed), dot(own.matrix[2], exposed)) + own.offset;
    // An exponent of 1 leaves what is negative.
    bvec3 is_curved = notEqual(own.gamma, vec3(1.0));
    vec3 curved = own.has_gamma != 0u ? mix(mixed, pow(max(mixed, 0.0), own.gamma), is_curved) : mixed;
    return own.has_response != 0u ? responded(own, clamp(curved, 0.0, 1.0)) : curved;
}

void main() {
    uint pixel = group_index() * 256u + gl_LocalInvocationIndex;
    uvec2 size_px = cameras[camera].size_px;
    if (pixel >= size_px.x * size_px.y) {
        return;
    }
    vec2 center_px = vec2(pixel % size_px.x, pixel / size_px.x) + 0.5;
    uint index = cameras[camera].first_pixel + pixel;
    vec4 value = blended[index];
    if (SKY) {
        vec3 ray = LENS ? rays[pixel] : vec3((center_px - cameras[camera].principal_px) / cameras[camera].focal_px, 1.0);
        // A rolling shutter exposes each pixel with the camera's pose at the pixel's own time.
        vec2 s_per_px = cameras[camera].shutter_s_per_px;
        if (s_per_px != vec2(0.0)) {
            float time_s = cameras[camera].shutter_first_s + dot(s_per_px, center_px);
            ray += turn_change(time_s * cameras[camera].turn_rad_per_s, ray);
        }
        vec3 sky = ray == vec3(0.0) ? vec3(0.0) : sky_color(right * ray.x + down * ray.y + forward * ray.z);
        vec3 splats = clamps_splats != 0u ? min(value.rgb, 1.0) : value.rgb;
        value.rgb = splats + (1.0 - value.a) * sky;
    }
    value.rgb = calibrated(value.rgb, center_px);
    if (COLOR_U8) {
        images_u8[index] = packUnorm4x8(value);
    } else {
        images_f32[index] = value;
    }
}
