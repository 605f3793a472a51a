// Levels of detail of the background: which nodes a camera draws; engine/scene/src/detail.rs.

struct DetailNode {
    vec3 center_m; // of a ball that holds all splats below the node
    float radius_m;
    float error_m; // how far splats that were merged lay apart
    uint parent;   // index of the node of the next coarser level, or NO_PARENT
};
const uint NO_PARENT = 0xffffffffu;

// True if splats of the node lie at most pitch_px pixels apart in the middle of the image.
bool fine_enough(DetailNode node, Camera camera, float pitch_px) {
    vec3 offset_m = from_camera_m(node.center_m, camera);
    // A node and its children ask this of the same node, and must get the same answer.
    precise float squared_m2 = offset_m.x * offset_m.x + offset_m.y * offset_m.y + offset_m.z * offset_m.z;
    precise float distance_m = sqrt(squared_m2) - node.radius_m;
    precise float error_px = node.error_m * max(camera.focal_px.x, camera.focal_px.y);
    precise float limit = pitch_px * max(distance_m, 0.0);
    return error_px <= limit;
}
