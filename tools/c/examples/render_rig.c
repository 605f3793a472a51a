/*
 * Opens a scene and draws two worlds over it, side by side in one call: in one the agents drive as the scene file says, in the other
 * the first of them stands across their way and one more is there. Writes what each camera saw last as PPM files.
 *
 * make install-c PREFIX=$HOME/.local, then, with PKG_CONFIG_PATH=$HOME/.local/lib/pkgconfig and LD_LIBRARY_PATH=$HOME/.local/lib:
 *
 * cc -std=c99 render_rig.c -o render_rig $(pkg-config --cflags --libs decouplegs)
 * ./render_rig street/scene.toml out [STEPS]
 *
 * The folder OUT must be there.
 */
#include "decouplegs.h"

#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* Ends the program when a call fails; the system releases what is open. */
#define CHECK(call) check((call), #call)

static void check(DgsStatus status, const char *call) {
    if (status != DGS_STATUS_OK) {
        fprintf(stderr, "%s: %s: %s\n", call, dgs_status_name(status), dgs_last_error());
        exit(1);
    }
}

static void *room_for(size_t count, size_t bytes) {
    void *room = calloc(count, bytes);
    if (room == NULL) {
        fprintf(stderr, "no memory for %zu times %zu bytes\n", count, bytes);
        exit(1);
    }
    return room;
}

/* Returns 0 when the image is on the disk. */
static int write_ppm(const char *path, const DgsImage *image) {
    FILE *file = fopen(path, "wb");
    int failed;
    if (file == NULL) {
        return 1;
    }
    failed = fprintf(file, "P6\n%u %u\n255\n", (unsigned)image->width_px, (unsigned)image->height_px) < 0;
    for (uint32_t y = 0; y < image->height_px; y++) {
        const uint8_t *pixel = (const uint8_t *)image->data + y * image->row_bytes;
        for (uint32_t x = 0; x < image->width_px; x++, pixel += image->pixel_bytes) {
            failed |= fwrite(pixel, 1, 3, file) != 3;
        }
    }
    failed |= fclose(file) != 0;
    return failed;
}

/* Worlds are called 0 and 1, cameras as in the scene file. */
static void write_images(const DgsScene *scene, const DgsBatchRenderer *renderer, size_t view, size_t camera_count, const char *out) {
    for (size_t camera = 0; camera < camera_count; camera++) {
        DgsImage image;
        char name[64], path[1024];
        CHECK(dgs_scene_camera_name(scene, camera, name, sizeof name, NULL));
        CHECK(dgs_batch_renderer_image(renderer, view, camera, DGS_IMAGE_KIND_RGBA_U8, &image));
        if (snprintf(path, sizeof path, "%s/%zu_%s.ppm", out, view, name) >= (int)sizeof path || write_ppm(path, &image)) {
            fprintf(stderr, "%s cannot be written\n", path);
            exit(1);
        }
        printf("%s\n", path);
    }
}

/* Puts the first agent of `world` ten meters before the ego, across its way, and one more beside it. */
static void block_the_way(DgsWorld *world, const DgsScene *scene, double time_s) {
    const DgsPose turn = {{0.70710678118654752, 0.0, 0.0, 0.70710678118654752}, {0.0, 0.0, 0.0}};
    DgsPose pose;
    DgsAgent first;
    char name[256];
    size_t count;
    CHECK(dgs_world_agent_count(world, &count));
    if (count == 0) {
        return;
    }
    CHECK(dgs_scene_ego_at(scene, time_s, &pose));
    memcpy(pose.rotation_wxyz, turn.rotation_wxyz, sizeof pose.rotation_wxyz);
    pose.position_m[0] += 10.0;
    CHECK(dgs_world_agent_name(world, 0, name, sizeof name, NULL));
    CHECK(dgs_world_move(world, name, &pose));
    CHECK(dgs_world_agent(world, 0, &first));
    pose.position_m[1] += 6.0;
    CHECK(dgs_world_place(world, "one more", first.asset, &pose, NULL));
}

int main(int count, char **arguments) {
    DgsSession *session = NULL;
    DgsScene *scene = NULL;
    DgsWorld *worlds[2] = {NULL, NULL};
    DgsBatchRenderer *renderer = NULL;
    DgsDevice device = {0};
    DgsStatistics statistics = {0};
    DgsView views[2];
    DgsCamera *cameras;
    size_t camera_count, agent_count;
    int steps;

    if (count != 3 && count != 4) {
        fprintf(stderr, "usage: render_rig SCENE.toml OUT [STEPS]: a scene file with a rig, a folder, how often to draw (10)\n");
        return 2;
    }
    if (dgs_abi_version() != DGS_ABI_VERSION) {
        fprintf(stderr, "the library has ABI %u, this program %u\n", (unsigned)dgs_abi_version(), (unsigned)DGS_ABI_VERSION);
        return 1;
    }
    steps = count == 4 ? atoi(arguments[3]) : 10;
    if (steps < 1) {
        fprintf(stderr, "STEPS is %s: expected 1 or more\n", arguments[3]);
        return 2;
    }

    CHECK(dgs_session_open(NULL, &session));
    device.struct_bytes = sizeof device;
    CHECK(dgs_session_device(session, &device));
    CHECK(dgs_scene_open(session, arguments[1], &scene));
    CHECK(dgs_scene_camera_count(scene, &camera_count));
    CHECK(dgs_scene_agent_count(scene, &agent_count));
    printf("%s (%s): %zu cameras, %zu agents\n", device.name, device.driver, camera_count, agent_count);
    if (camera_count == 0) {
        fprintf(stderr, "%s has no rig: add [[rig]] tables to it\n", arguments[1]);
        return 1;
    }

    cameras = room_for(camera_count, sizeof *cameras);
    CHECK(dgs_world_new(scene, &worlds[0]));
    CHECK(dgs_world_clone(worlds[0], &worlds[1]));
    CHECK(dgs_batch_renderer_new(session, &renderer));
    for (size_t world = 0; world < 2; world++) {
        views[world].world = worlds[world];
        views[world].cameras = cameras;
        views[world].camera_count = camera_count;
    }
    statistics.struct_bytes = sizeof statistics;
    for (int step = 0; step < steps; step++) {
        const double time_s = 0.1 * step;
        for (size_t camera = 0; camera < camera_count; camera++) {
            CHECK(dgs_scene_camera_at(scene, camera, time_s, &cameras[camera]));
        }
        CHECK(dgs_world_set_time(worlds[0], time_s));
        CHECK(dgs_world_set_time(worlds[1], time_s));
        block_the_way(worlds[1], scene, time_s);
        CHECK(dgs_batch_renderer_draw(renderer, views, 2));
        CHECK(dgs_batch_renderer_statistics(renderer, &statistics));
        printf("%.1f s: %.2f ms on the device, %.2f ms in all, %llu splats, %u agents, drawn again %u times, %llu bytes\n", time_s,
               statistics.gpu_ms, statistics.wall_ms, (unsigned long long)statistics.splats_listed, (unsigned)statistics.agents,
               (unsigned)statistics.redrawn, (unsigned long long)statistics.memory_bytes);
    }
    write_images(scene, renderer, 0, camera_count, arguments[2]);
    write_images(scene, renderer, 1, camera_count, arguments[2]);

    free(cameras);
    CHECK(dgs_batch_renderer_close(renderer));
    CHECK(dgs_world_close(worlds[1]));
    CHECK(dgs_world_close(worlds[0]));
    CHECK(dgs_scene_close(scene));
    CHECK(dgs_session_close(session));
    return 0;
}
