/*
 * One splat file, one image: opens the splats, puts a camera where it sees them all, and writes a PNG.
 *
 *     make install-c PREFIX=$HOME/.local
 *     export PKG_CONFIG_PATH=$HOME/.local/lib/pkgconfig
 *     cc render_ply.c -o render_ply $(pkg-config --cflags --libs decouplegs)
 *     LD_LIBRARY_PATH=$HOME/.local/lib ./render_ply garden.ply garden.png
 */
#include "decouplegs.h"

#include <stdio.h>
#include <stdlib.h>

#define CHECK(call) check((call), #call)

static void check(DgsStatus status, const char *call) {
    if (status != DGS_STATUS_OK) {
        fprintf(stderr, "%s: %s: %s\n", call, dgs_status_name(status), dgs_last_error());
        exit(1);
    }
}

int main(int count, char **arguments) {
    DgsSession *session = NULL;
    DgsScene *scene = NULL;
    DgsWorld *world = NULL;
    DgsBatchRenderer *renderer = NULL;
    DgsCamera camera;
    DgsView view;
    DgsImage image;
    if (count != 3) {
        fprintf(stderr, "usage: render_ply SPLATS IMAGE.png\n");
        return 2;
    }
    if (dgs_abi_version() != DGS_ABI_VERSION) {
        fprintf(stderr, "the library has version %u, and this program was built for %u\n", (unsigned)dgs_abi_version(),
                (unsigned)DGS_ABI_VERSION);
        return 1;
    }
    CHECK(dgs_session_open(NULL, &session));
    CHECK(dgs_scene_open(session, arguments[1], &scene));
    CHECK(dgs_scene_frame(scene, 1280, 720, NULL, NULL, &camera));
    CHECK(dgs_world_new(scene, &world));
    CHECK(dgs_batch_renderer_new(session, &renderer));
    view.world = world;
    view.cameras = &camera;
    view.camera_count = 1;
    CHECK(dgs_batch_renderer_draw(renderer, &view, 1));
    CHECK(dgs_batch_renderer_image(renderer, 0, 0, DGS_IMAGE_KIND_RGBA_U8, &image));
    CHECK(dgs_save_png(arguments[2], &image));
    printf("%s: %ux%u pixels\n", arguments[2], (unsigned)image.width_px, (unsigned)image.height_px);
    CHECK(dgs_batch_renderer_close(renderer));
    CHECK(dgs_world_close(world));
    CHECK(dgs_scene_close(scene));
    CHECK(dgs_session_close(session));
    return 0;
}
