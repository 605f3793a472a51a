/*
 * Images of every kind, of sessions of every kind: bytes are the same whether depth is drawn beside them or not, and are the floats
 * rounded; depth and instances are where the agent is; planes of geometry agree with depth and with each other.
 *
 * images SCENE.toml: a scene with a rig whose first camera sees an agent.
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
        fprintf(stderr, "%s: not so\n", what);
        exit(1);
    }
}

struct drawn {
    DgsSession *session;
    DgsBatchRenderer *renderer;
    size_t pixels;
    uint32_t first_instance;
};

/* The first camera's image of the scene, in a session of its own. */
static struct drawn draw(const char *path, uint32_t color, uint32_t planes) {
    struct drawn drawn = {0};
    DgsSessionOptions options = {0};
    DgsScene *scene = NULL;
    DgsWorld *world = NULL;
    DgsCamera camera;
    DgsAgent agent;
    DgsView view;
    options.struct_bytes = sizeof options;
    options.color = color;
    options.depth = planes;
    options.instance = planes;
    if (planes) {
        options.planes = 0x1f << DGS_IMAGE_KIND_RANGE_F32;
        options.flow_interval_s = 0.05;
    }
    options.device = "auto";
    CHECK(dgs_session_open(&options, &drawn.session));
    CHECK(dgs_scene_open(drawn.session, path, &scene));
    CHECK(dgs_world_new(scene, &world));
    CHECK(dgs_batch_renderer_new(drawn.session, &drawn.renderer));
    CHECK(dgs_scene_camera_at(scene, 0, 0.0, &camera));
    CHECK(dgs_world_agent(world, 0, &agent));
    drawn.first_instance = agent.instance;
    drawn.pixels = (size_t)camera.width_px * camera.height_px;
    view.world = world;
    view.cameras = &camera;
    view.camera_count = 1;
    CHECK(dgs_batch_renderer_draw(drawn.renderer, &view, 1));
    CHECK(dgs_world_close(world));
    CHECK(dgs_scene_close(scene));
    return drawn;
}

static const void *pixels(const struct drawn *drawn, uint32_t kind, size_t pixel_bytes) {
    DgsImage image;
    CHECK(dgs_batch_renderer_image(drawn->renderer, 0, 0, kind, &image));
    require(image.kind == kind && image.pixel_bytes == pixel_bytes, "a pixel has its size");
    require(image.row_bytes == pixel_bytes * image.width_px, "rows follow one another");
    return image.data;
}

static void end(struct drawn *drawn) {
    CHECK(dgs_batch_renderer_close(drawn->renderer));
    CHECK(dgs_session_close(drawn->session));
}

int main(int count, char **arguments) {
    struct drawn plain, full, floats;
    const uint8_t *bytes;
    const float *colors, *depths, *ranges, *normals, *flows, *backward, *velocities;
    const uint16_t *instances;
    size_t lit = 0, on_agent = 0, moving = 0;
    if (count != 2) {
        fprintf(stderr, "usage: images SCENE.toml\n");
        return 2;
    }
    plain = draw(arguments[1], DGS_COLOR_U8, 0);
    full = draw(arguments[1], DGS_COLOR_U8, 1);
    floats = draw(arguments[1], DGS_COLOR_F32, 1);

    bytes = pixels(&plain, DGS_IMAGE_KIND_RGBA_U8, 4);
    require(memcmp(bytes, pixels(&full, DGS_IMAGE_KIND_RGBA_U8, 4), 4 * plain.pixels) == 0, "bytes are the same beside depth");
    colors = pixels(&floats, DGS_IMAGE_KIND_RGBA_F32, 16);
    depths = pixels(&floats, DGS_IMAGE_KIND_DEPTH_F32, 4);
    require(memcmp(depths, pixels(&full, DGS_IMAGE_KIND_DEPTH_F32, 4), 4 * plain.pixels) == 0, "depth is the same beside bytes");
    instances = pixels(&full, DGS_IMAGE_KIND_INSTANCE_U16, 2);
    ranges = pixels(&full, DGS_IMAGE_KIND_RANGE_F32, 4);
    normals = pixels(&full, DGS_IMAGE_KIND_NORMAL_F32, 12);
    flows = pixels(&full, DGS_IMAGE_KIND_FLOW_FORWARD_F32, 8);
    backward = pixels(&full, DGS_IMAGE_KIND_FLOW_BACKWARD_F32, 8);
    velocities = pixels(&full, DGS_IMAGE_KIND_SCENE_FLOW_F32, 12);
    for (size_t pixel = 0; pixel < plain.pixels; pixel++) {
        const float *normal = normals + 3 * pixel, *velocity = velocities + 3 * pixel;
        const float speed = hypotf(hypotf(velocity[0], velocity[1]), velocity[2]);
        require(ranges[pixel] >= 0.9999F * depths[pixel], "a range is no shorter than its depth");
        require(hypotf(hypotf(normal[0], normal[1]), normal[2]) <= 1.0001F, "a normal has at most unit length");
        require(instances[pixel] != 0 || speed < 5.1F, "what moves is the agent");
        if (instances[pixel] != 0 && speed > 4.0F) {
            moving++;
            require(fabsf(flows[2 * pixel]) + fabsf(flows[2 * pixel + 1]) > 0.0F, "what moves flows");
            require(backward[2 * pixel] != flows[2 * pixel], "and comes from elsewhere");
        }
        for (size_t channel = 0; channel < 4; channel++) {
            const float value = fminf(fmaxf(colors[4 * pixel + channel], 0.0F), 1.0F);
            require(fabsf(255.0F * value - bytes[4 * pixel + channel]) <= 0.51F, "bytes are the floats rounded");
        }
        lit += bytes[4 * pixel] > 0;
        if (instances[pixel] == full.first_instance) {
            on_agent++;
            require(depths[pixel] > 0.5F && depths[pixel] < 200.0F, "an agent has a depth");
        }
    }
    require(lit > plain.pixels / 2, "the image shows something");
    require(on_agent > 4, "the agent is in the image");
    require(moving > 4, "the agent moves");
    printf("%lu of %lu pixels are the agent's\n", (unsigned long)on_agent, (unsigned long)plain.pixels);
    end(&plain);
    end(&full);
    end(&floats);
    return 0;
}
