// The camera whose image a coarse tile belongs to.
//
// Included where cameras are bound.

uint camera_of_bin(uint bin, uint camera_count) {
    uint camera = 0u;
    for (uint next = 1u; next < camera_count; ++next) {
        camera = cameras[next].first_bin <= bin ? next : camera;
    }
    return camera;
}
