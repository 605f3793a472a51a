/*
 * A sweep of the scene's first LiDAR at a pose in motion, its points written as they are, and what is refused.
 *
 * sweep SCENE.toml OUT: a scene with a LiDAR and an agent; a file for the points.
 */
#include "decouplegs.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define CHECK(call) check((call), #call)
#define REFUSED(status, words, call) refused((status), (words), (call), #call)

static void check(DgsStatus status, const char *call) {
    if (status != DGS_STATUS_OK) {
        fprintf(stderr, "%s: %s: %s\n", call, dgs_status_name(status), dgs_last_error());
        exit(1);
    }
}

static void refused(DgsStatus expected, const char *words, DgsStatus found, const char *call) {
    if (found != expected || strstr(dgs_last_error(), words) == NULL) {
        fprintf(stderr, "%s: expected %s (%s), found %s: %s\n", call, dgs_status_name(expected), words, dgs_status_name(found),
                dgs_last_error());
        exit(1);
    }
}

int main(int argc, char **argv) {
    DgsSession *session = NULL;
    DgsScene *scene = NULL;
    DgsWorld *world = NULL;
    DgsBatchRenderer *renderer = NULL;
    DgsLidar *lidar = NULL, *other = NULL;
    DgsPose mounted;
    DgsSessionOptions session_options = {0};
    DgsSweepOptions options = {0};
    const DgsLidarPoint *points = NULL;
    size_t lidars = 0, beams = 0, count = 7;
    double sweep_s = 0.0;
    FILE *out;
    if (argc != 3) {
        return 2;
    }
    session_options.struct_bytes = sizeof session_options;
    CHECK(dgs_session_open(&session_options, &session));
    CHECK(dgs_scene_open(session, argv[1], &scene));
    CHECK(dgs_world_new(scene, &world));
    CHECK(dgs_world_set_time(world, 0.5));
    CHECK(dgs_batch_renderer_new(session, &renderer));
    CHECK(dgs_batch_renderer_points(renderer, &points, &count));
    if (count != 0) {
        fprintf(stderr, "%zu points before the first sweep\n", count);
        return 1;
    }
    CHECK(dgs_scene_lidar_count(scene, &lidars));
    REFUSED(DGS_STATUS_NOT_FOUND, "no LiDAR 1", dgs_scene_lidar(scene, lidars, &lidar, &mounted));
    CHECK(dgs_scene_lidar(scene, 0, &lidar, &mounted));
    CHECK(dgs_lidar_beam_count(lidar, &beams));
    CHECK(dgs_lidar_sweep_s(lidar, &sweep_s));
    REFUSED(DGS_STATUS_FILE, "no_such_sensor", dgs_lidar_open("no_such_sensor", &other));
    CHECK(dgs_lidar_open("at128", &other));
    CHECK(dgs_lidar_close(other));
    REFUSED(DGS_STATUS_INVALID_HANDLE, "is no LiDAR", dgs_lidar_close(other));

    REFUSED(DGS_STATUS_INVALID_ARGUMENT, "struct_bytes", dgs_batch_renderer_sweep(renderer, world, lidar, &options));
    options.struct_bytes = sizeof options;
    REFUSED(DGS_STATUS_INVALID_ARGUMENT, "rotation of the LiDAR", dgs_batch_renderer_sweep(renderer, world, lidar, &options));
    options.world_from_lidar = mounted;
    options.velocity_mps[0] = NAN;
    REFUSED(DGS_STATUS_INVALID_ARGUMENT, "NaN", dgs_batch_renderer_sweep(renderer, world, lidar, &options));
    options.velocity_mps[0] = 12.0;
    options.turn_rad_per_s[2] = 0.5;
    options.frame = 4;
    REFUSED(DGS_STATUS_INVALID_ARGUMENT, "frame is 4", dgs_batch_renderer_sweep(renderer, world, lidar, &options));
    options.frame = DGS_POINT_FRAME_WORLD;
    options.returns = 5;
    REFUSED(DGS_STATUS_INVALID_ARGUMENT, "returns is 5", dgs_batch_renderer_sweep(renderer, world, lidar, &options));
    options.returns = DGS_RETURN_EXPECTED;
    options.opacity_min = 2.0f;
    REFUSED(DGS_STATUS_INVALID_ARGUMENT, "opacity_min is 2", dgs_batch_renderer_sweep(renderer, world, lidar, &options));
    options.opacity_min = 0.25f;
    CHECK(dgs_batch_renderer_sweep(renderer, world, lidar, &options));
    CHECK(dgs_batch_renderer_points(renderer, &points, &count));
    out = fopen(argv[2], "wb");
    if (out == NULL || fwrite(points, sizeof *points, count, out) != count || fclose(out) != 0) {
        return 1;
    }
    printf("%zu of %zu beams in %g s\n", count, beams, sweep_s);
    CHECK(dgs_lidar_close(lidar));
    CHECK(dgs_batch_renderer_close(renderer));
    CHECK(dgs_world_close(world));
    CHECK(dgs_scene_close(scene));
    CHECK(dgs_session_close(session));
    return 0;
}
