/*
 * Cameras of every kind: a rig of a text is the rig of the scene that describes the same, lenses and shutters change the image, and
 * nonsense is refused.
 *
 * cameras SPLATS OUT: a splat file, and a folder for the images.
 */
#include "decouplegs.h"

#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define CHECK(call) check((call), #call)

static void check(DgsStatus status, const char *call) {
    if (status != DGS_STATUS_OK) {
        fprintf(stderr, "%s: %s: %s\n", call, dgs_status_name(status), dgs_last_error());
        exit(1);
    }
}

static void require(int holds, const char *what) {
    if (!holds) {
        fprintf(stderr, "%s: not so (%s)\n", what, dgs_last_error());
        exit(1);
    }
}

/* The call must fail with this status, and say this. */
static void refuse(DgsStatus status, DgsStatus expected, const char *part) {
    require(status == expected, part);
    require(strstr(dgs_last_error(), part) != NULL, part);
}

enum { WIDTH = 64, HEIGHT = 48, BYTES = 4 * WIDTH * HEIGHT };

/* The pixels of the first camera of the last draw. */
static uint8_t *copied(const DgsBatchRenderer *renderer) {
    DgsImage image;
    uint8_t *bytes = malloc(BYTES);
    CHECK(dgs_batch_renderer_image(renderer, 0, 0, DGS_IMAGE_KIND_RGBA_U8, &image));
    require(image.width_px == WIDTH && image.height_px == HEIGHT, "the image has the size of its camera");
    memcpy(bytes, image.data, BYTES);
    return bytes;
}

/* The image that the rig of a text takes from the pose of `camera`. */
static uint8_t *drawn(DgsBatchRenderer *renderer, const DgsWorld *world, const DgsCamera *camera, const char *text, double speed) {
    DgsRig *rig = NULL;
    DgsRigView view = {0};
    uint8_t *bytes;
    CHECK(dgs_rig_from_text(text, &rig));
    view.world = world;
    view.rig = rig;
    view.world_from_rig = camera->world_from_camera;
    view.velocity_mps[0] = speed;
    view.velocity_mps[2] = speed;
    CHECK(dgs_batch_renderer_draw_rigs(renderer, &view, 1));
    bytes = copied(renderer);
    CHECK(dgs_rig_close(rig));
    return bytes;
}

int main(int count, char **arguments) {
    DgsSession *session = NULL;
    DgsScene *scene = NULL;
    DgsWorld *world = NULL;
    DgsBatchRenderer *renderer = NULL;
    DgsRig *rig = NULL;
    DgsCamera camera, by_hand;
    DgsView view;
    DgsRigView rig_view = {0};
    DgsImage image;
    DgsSessionOptions options = {0};
    char text[512], lens[1024], path[4096], name[16];
    size_t cameras = 0;
    uint8_t *pinhole, *same, *fisheye, *rolling, *standing, *darker;
    const double origin[3] = {0, 0, 0}, up[3] = {0, -1, 0}, ahead[3] = {0, 0, 1};
    if (count != 3) {
        fprintf(stderr, "usage: cameras SPLATS OUT\n");
        return 2;
    }
    options.struct_bytes = sizeof options;
    options.rules = "unheard-of";
    refuse(dgs_session_open(&options, &session), DGS_STATUS_INVALID_ARGUMENT, "gsplat15");
    options.rules = "gsplat15";
    CHECK(dgs_session_open(&options, &session));
    CHECK(dgs_scene_open(session, arguments[1], &scene));
    CHECK(dgs_world_new(scene, &world));
    CHECK(dgs_batch_renderer_new(session, &renderer));
    refuse(dgs_scene_rig(scene, &rig), DGS_STATUS_NOT_FOUND, "no cameras");
    refuse(dgs_scene_frame(scene, 0, HEIGHT, NULL, NULL, &camera), DGS_STATUS_NOT_FOUND, "0x48");
    refuse(dgs_scene_frame(scene, WIDTH, HEIGHT, up, up, &camera), DGS_STATUS_NOT_FOUND, "direction");
    CHECK(dgs_scene_frame(scene, WIDTH, HEIGHT, NULL, NULL, &camera));

    view.world = world;
    view.cameras = &camera;
    view.camera_count = 1;
    CHECK(dgs_batch_renderer_draw(renderer, &view, 1));
    pinhole = copied(renderer);
    CHECK(dgs_batch_renderer_image(renderer, 0, 0, DGS_IMAGE_KIND_RGBA_U8, &image));
    snprintf(path, sizeof path, "%s/pinhole.png", arguments[2]);
    CHECK(dgs_save_png(path, &image));
    image.kind = DGS_IMAGE_KIND_DEPTH_F32;
    refuse(dgs_save_png(path, &image), DGS_STATUS_INVALID_ARGUMENT, "RGBA_U8");
    image.kind = DGS_IMAGE_KIND_RGBA_U8;
    image.row_bytes = 4;
    refuse(dgs_save_png(path, &image), DGS_STATUS_INVALID_ARGUMENT, "bytes a row");
    image.row_bytes = (size_t)-1;
    refuse(dgs_save_png(path, &image), DGS_STATUS_INVALID_ARGUMENT, "memory");

    snprintf(text, sizeof text, "{\"width_px\": %d, \"height_px\": %d, \"fx_px\": %.17g", WIDTH, HEIGHT, camera.fx_px);
    snprintf(lens, sizeof lens, "%s}", text);
    same = drawn(renderer, world, &camera, lens, 0);
    require(memcmp(pinhole, same, BYTES) == 0, "a pinhole of a text is that of a struct");
    snprintf(lens, sizeof lens, "%s, \"lens\": {\"model\": \"opencv-fisheye\", \"radial\": [0.2]}}", text);
    fisheye = drawn(renderer, world, &camera, lens, 0);
    require(memcmp(pinhole, fisheye, BYTES) != 0, "a lens bends the image");
    snprintf(lens, sizeof lens, "%s, \"shutter\": {\"direction\": \"top_to_bottom\", \"readout_s\": 0.05}}", text);
    rolling = drawn(renderer, world, &camera, lens, 3);
    standing = drawn(renderer, world, &camera, lens, 0);
    require(memcmp(pinhole, rolling, BYTES) != 0, "a rolling shutter sees motion");
    require(memcmp(pinhole, standing, BYTES) == 0, "and none where there is none");
    snprintf(lens, sizeof lens, "%s, \"photometry\": {\"exposure_ev\": -2.0}}", text);
    darker = drawn(renderer, world, &camera, lens, 0);
    require(memcmp(pinhole, darker, BYTES) != 0, "an exposure darkens");

    refuse(dgs_rig_from_text("{\"width_px\": 8}", &rig), DGS_STATUS_INVALID_ARGUMENT, "height_px");
    require(rig == NULL, "a handle of a failed call is NULL");
    refuse(dgs_rig_from_text("hello", &rig), DGS_STATUS_INVALID_ARGUMENT, "neither TOML nor JSON");
    refuse(dgs_rig_from_text(NULL, &rig), DGS_STATUS_INVALID_ARGUMENT, "NULL");
    CHECK(dgs_rig_from_text("[[rig]]\nname = \"front\"\nwidth_px = 8\nheight_px = 6\nfx_px = 9.0\n", &rig));
    CHECK(dgs_rig_camera_count(rig, &cameras));
    CHECK(dgs_rig_camera_name(rig, 0, name, sizeof name, NULL));
    require(cameras == 1 && strcmp(name, "front") == 0, "a rig names its cameras");
    refuse(dgs_rig_camera_name(rig, 1, name, sizeof name, NULL), DGS_STATUS_NOT_FOUND, "no camera 1");
    rig_view.world = world;
    rig_view.rig = rig;
    refuse(dgs_batch_renderer_draw_rigs(renderer, &rig_view, 1), DGS_STATUS_INVALID_ARGUMENT, "length 1");
    rig_view.world_from_rig = camera.world_from_camera;
    rig_view.velocity_mps[1] = NAN;
    refuse(dgs_batch_renderer_draw_rigs(renderer, &rig_view, 1), DGS_STATUS_INVALID_ARGUMENT, "finite");
    refuse(dgs_batch_renderer_draw_rigs(renderer, &rig_view, 0), DGS_STATUS_INVALID_ARGUMENT, "at least one");
    CHECK(dgs_rig_close(rig));
    rig_view.velocity_mps[1] = 0;
    refuse(dgs_batch_renderer_draw_rigs(renderer, &rig_view, 1), DGS_STATUS_INVALID_HANDLE, "closed");

    CHECK(dgs_camera_look_at(WIDTH, HEIGHT, 1.0, origin, ahead, up, &by_hand));
    require(fabs(by_hand.world_from_camera.rotation_wxyz[0]) > 0.999999, "it looks along z, y down");
    refuse(dgs_camera_look_at(WIDTH, HEIGHT, 4.0, origin, ahead, up, &by_hand), DGS_STATUS_INVALID_ARGUMENT, "fov_rad");
    refuse(dgs_camera_look_at(WIDTH, HEIGHT, 1.0, origin, origin, up, &by_hand), DGS_STATUS_INVALID_ARGUMENT, "target");
    refuse(dgs_camera_look_at(0, HEIGHT, 1.0, origin, ahead, up, &by_hand), DGS_STATUS_INVALID_ARGUMENT, "0x48");

    free(pinhole);
    free(same);
    free(fisheye);
    free(rolling);
    free(standing);
    free(darker);
    CHECK(dgs_batch_renderer_close(renderer));
    CHECK(dgs_world_close(world));
    CHECK(dgs_scene_close(scene));
    CHECK(dgs_session_close(session));
    printf("all kinds of cameras\n");
    return 0;
}
