// Conservative frustum culling of boxes and splats. The test of a box is conservative for the
// projection used: a splat's half-width in pixels is at most reach * (focal / z) * sqrt(1 +
// slope_limit^2) plus the dilation, so 'reaches the image' is a plane test.

// Pixels that dilation adds to a splat's half-width at most: sqrt(0.3 * 2 ln 255), rounded up.
const float DILATION_RADIUS_PX = 1.9;

// The largest value of dot(normal, p) over the cluster's box, p relative to the camera.
float farthest(Cluster cluster, vec3 center, vec3 normal) {
    return dot(normal, center) + dot(abs(normal), cluster.half_extent_m);
}

bool cluster_overlaps(Cluster cluster, Camera camera) {
    vec3 center = from_camera_m(cluster.center_m, camera);
    vec2 spread = sqrt(1.0 + pow(max(abs(camera.slope_min), abs(camera.slope_max)), vec2(2.0)));
    // Rounding of the box, relative to its distance.
    float slack = 1e-5 * (dot(abs(center), vec3(1.0)) + dot(cluster.half_extent_m, vec3(1.0)) + cluster.splat_radius_m);
    vec2 radius = cluster.splat_radius_m * spread + slack;
    vec2 low = (camera.principal_px + DILATION_RADIUS_PX) / camera.focal_px;
    vec2 high = (vec2(camera.size_px) - camera.principal_px + DILATION_RADIUS_PX) / camera.focal_px;
    return farthest(cluster, center, camera.row_z) + slack >= NEAR_M
        && farthest(cluster, center, camera.row_x + low.x * camera.row_z) + radius.x >= 0.0
        && farthest(cluster, center, -camera.row_x + high.x * camera.row_z) + radius.x >= 0.0
        && farthest(cluster, center, camera.row_y + low.y * camera.row_z) + radius.y >= 0.0
        && farthest(cluster, center, -camera.row_y + high.y * camera.row_z) + radius.y >= 0.0;
}

bool splat_overlaps(Footprint splat, Camera camera) {
    ivec2 rows = reached_coarse_rows(splat, camera.size_px.y);
    for (int row = rows.x; row <= rows.y; ++row) {
        ivec2 tiles = reached_coarse_tiles(splat, uint(row), camera.size_px);
        if (tiles.x <= tiles.y) {
            return true;
        }
    }
    return false;
}

vec3 to_camera_axes(Camera camera, vec3 offset) {
    return vec3(dot(camera.row_x, offset), dot(camera.row_y, offset), dot(camera.row_z, offset));
}

// The index of bit `bit` among the set bits of a cluster's words, or -1 when it is not set.
#define VISIBLE_RANK(bits, first_word, bit)                          \
    uint word = bits[(first_word) + (bit) / 32u];                    \
    if ((word >> ((bit) % 32u) & 1u) == 0u) {                        \
        return -1;                                                   \
    }                                                                \
    int rank = bitCount(word & ((1u << ((bit) % 32u)) - 1u));        \
    for (uint earlier = 0u; earlier < (bit) / 32u; ++earlier) {      \
        rank += bitCount(bits[(first_word) + earlier]);              \
    }                                                                \
    return rank
