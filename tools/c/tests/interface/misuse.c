/*
 * Does what nobody should, and checks that each fault is told and that everything works afterwards. Then what is allowed: handles closed
 * in any order, and two batch renderers on two threads.
 *
 * misuse SCENE.toml: a scene with a rig and an agent.
 */
#include "decouplegs.h"

#include <math.h>
#include <pthread.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static int failures = 0;

/* The call must end with the status, and say so with the words where it fails. */
#define EXPECT(status, words, call) expect((status), (words), (call), #call, __LINE__)
#define OK(call) expect(DGS_STATUS_OK, "", (call), #call, __LINE__)

static void expect(DgsStatus expected, const char *words, DgsStatus found, const char *call, int line) {
    const char *said = dgs_last_error();
    const int silent = expected == DGS_STATUS_OK;
    if (found != expected || (silent ? said[0] != '\0' : said[0] == '\0' || strstr(said, words) == NULL)) {
        fprintf(stderr, "line %d: %s: expected %s (%s), found %s: %s\n", line, call, dgs_status_name(expected), words,
                dgs_status_name(found), said);
        failures++;
    }
}

static void require(int holds, const char *what) {
    if (!holds) {
        fprintf(stderr, "%s: not so\n", what);
        failures++;
    }
}

static const DgsPose STANDING = {{1.0, 0.0, 0.0, 0.0}, {8.0, 1.0, 0.0}};

static void misuse_devices(void) {
    DgsDevice device = {0};
    size_t count = 0;
    EXPECT(DGS_STATUS_INVALID_ARGUMENT, "count is NULL", dgs_device_count(NULL));
    OK(dgs_device_count(&count));
    require(count > 0, "there is a device");
    EXPECT(DGS_STATUS_INVALID_ARGUMENT, "struct_bytes of device is 0", dgs_device(0, &device));
    device.struct_bytes = UINT32_MAX;
    EXPECT(DGS_STATUS_INVALID_ARGUMENT, "struct_bytes", dgs_device(0, &device));
    device.struct_bytes = sizeof device;
    EXPECT(DGS_STATUS_NOT_FOUND, "no device", dgs_device(count, &device));
    EXPECT(DGS_STATUS_NOT_FOUND, "no device", dgs_device(SIZE_MAX, &device));
    EXPECT(DGS_STATUS_INVALID_ARGUMENT, "device is NULL", dgs_device(0, NULL));
    OK(dgs_device(0, &device));
    require(device.name[0] != '\0' && device.struct_bytes == sizeof device, "a device has a name");
}

static void misuse_options(void) {
    DgsSession *session = (DgsSession *)&failures;
    DgsSessionOptions options = {0};
    EXPECT(DGS_STATUS_INVALID_ARGUMENT, "session is NULL", dgs_session_open(NULL, NULL));
    EXPECT(DGS_STATUS_INVALID_ARGUMENT, "struct_bytes of options is 0", dgs_session_open(&options, &session));
    require(session == NULL, "a handle is NULL where opening failed");
    options.struct_bytes = sizeof options;
    options.color = 2;
    EXPECT(DGS_STATUS_INVALID_ARGUMENT, "color is 2", dgs_session_open(&options, &session));
    options.color = DGS_COLOR_U8;
    options.depth = 7;
    EXPECT(DGS_STATUS_INVALID_ARGUMENT, "depth is 7", dgs_session_open(&options, &session));
    options.depth = 0;
    options.planes = 1;
    EXPECT(DGS_STATUS_INVALID_ARGUMENT, "planes is 0x1", dgs_session_open(&options, &session));
    options.planes = 0;
    options.storage = 2;
    EXPECT(DGS_STATUS_INVALID_ARGUMENT, "storage is 2", dgs_session_open(&options, &session));
    options.storage = DGS_STORAGE_EXACT;
    options.background_pitch_px = -2.0;
    EXPECT(DGS_STATUS_INVALID_ARGUMENT, "background_pitch_px is -2", dgs_session_open(&options, &session));
    options.background_pitch_px = 0.0;
    options.flow_interval_s = -1.0;
    EXPECT(DGS_STATUS_INVALID_ARGUMENT, "flow_interval_s is -1", dgs_session_open(&options, &session));
    options.flow_interval_s = 0.0;
    options.device = "no device is called so";
    EXPECT(DGS_STATUS_NOT_FOUND, "no device is called so", dgs_session_open(&options, &session));
    options.device = "\xff\xfe";
    EXPECT(DGS_STATUS_INVALID_ARGUMENT, "not UTF-8", dgs_session_open(&options, &session));
}

static void misuse_scenes(const DgsSession *session, const char *path) {
    DgsScene *scene = NULL;
    DgsCamera camera;
    DgsPose pose;
    char name[4];
    float size_m[3];
    size_t count = 0, length = 0;
    uint32_t asset = 0, present = 0;
    EXPECT(DGS_STATUS_FILE, "nowhere.toml", dgs_scene_open(session, "nowhere.toml", &scene));
    EXPECT(DGS_STATUS_INVALID_ARGUMENT, "path is NULL", dgs_scene_open(session, NULL, &scene));
    EXPECT(DGS_STATUS_INVALID_ARGUMENT, "scene is NULL", dgs_scene_open(session, path, NULL));
    EXPECT(DGS_STATUS_INVALID_HANDLE, "found NULL", dgs_scene_open(NULL, path, &scene));
    OK(dgs_scene_open(session, path, &scene));
    EXPECT(DGS_STATUS_INVALID_HANDLE, "no session", dgs_session_memory((const DgsSession *)(const void *)scene, NULL));
    EXPECT(DGS_STATUS_INVALID_HANDLE, "no scene", dgs_scene_camera_count((const DgsScene *)(const void *)session, &count));
    EXPECT(DGS_STATUS_INVALID_HANDLE, "no scene", dgs_scene_camera_count((const DgsScene *)(const void *)&camera, &count));
    OK(dgs_scene_camera_count(scene, &count));
    EXPECT(DGS_STATUS_NOT_FOUND, "no camera", dgs_scene_camera_at(scene, count, 0.0, &camera));
    EXPECT(DGS_STATUS_INVALID_ARGUMENT, "time is", dgs_scene_camera_at(scene, 0, NAN, &camera));
    EXPECT(DGS_STATUS_INVALID_ARGUMENT, "time is", dgs_scene_ego_at(scene, INFINITY, &pose));
    EXPECT(DGS_STATUS_TOO_SMALL, "6 bytes, the buffer has 4", dgs_scene_camera_name(scene, 0, name, sizeof name, &length));
    require(length == 5, "the name's length is told");
    EXPECT(DGS_STATUS_INVALID_ARGUMENT, "buffer is NULL", dgs_scene_camera_name(scene, 0, NULL, 9, NULL));
    OK(dgs_scene_camera_name(scene, 1, NULL, 0, &length));
    EXPECT(DGS_STATUS_NOT_FOUND, "no agent", dgs_scene_agent_name(scene, SIZE_MAX, name, sizeof name, NULL));
    EXPECT(DGS_STATUS_NOT_FOUND, "no agent", dgs_scene_agent_present_at(scene, SIZE_MAX, 0.0, &present));
    OK(dgs_scene_agent_present_at(scene, 0, 0.0, &present));
    require(present == 1, "the car is there");
    EXPECT(DGS_STATUS_NOT_FOUND, "no asset 9", dgs_scene_asset_size(scene, 9, size_m));
    OK(dgs_scene_asset_size(scene, 0, size_m));
    require(size_m[0] > 1.0F && size_m[1] > 1.0F && size_m[2] > 0.5F, "a car has a size");
    EXPECT(DGS_STATUS_FILE, "nothing.safetensors", dgs_scene_add_asset(scene, "nothing.safetensors", &asset));
    memset(&pose, 0, sizeof pose);
    EXPECT(DGS_STATUS_INVALID_ARGUMENT, "the rotation of the ego", dgs_scene_camera_on(scene, 0, &pose, &camera));
    OK(dgs_scene_camera_on(scene, 0, &STANDING, &camera));
    OK(dgs_scene_close(scene));
    EXPECT(DGS_STATUS_INVALID_HANDLE, "closed", dgs_scene_close(scene));
    EXPECT(DGS_STATUS_INVALID_HANDLE, "closed", dgs_scene_camera_count(scene, &count));
    OK(dgs_scene_close(NULL));
}

static void misuse_worlds(const DgsScene *scene) {
    DgsWorld *world = NULL, *copy = NULL;
    DgsPose pose = STANDING;
    DgsAgent agent;
    size_t before = 0, count = 0;
    uint32_t instance = 0;
    EXPECT(DGS_STATUS_INVALID_HANDLE, "found NULL", dgs_world_new(NULL, &world));
    OK(dgs_world_new(scene, &world));
    OK(dgs_world_agent_count(world, &before));
    EXPECT(DGS_STATUS_NOT_FOUND, "no agent", dgs_world_agent_present(world, SIZE_MAX, &instance));
    OK(dgs_world_agent_present(world, 0, &instance));
    require(instance == 1, "the car is there");
    EXPECT(DGS_STATUS_NOT_FOUND, "no agent \"nobody\"", dgs_world_move(world, "nobody", &pose));
    EXPECT(DGS_STATUS_NOT_FOUND, "nobody", dgs_world_remove(world, "nobody"));
    EXPECT(DGS_STATUS_INVALID_ARGUMENT, "name is NULL", dgs_world_move(world, NULL, &pose));
    EXPECT(DGS_STATUS_INVALID_ARGUMENT, "pose is NULL", dgs_world_move(world, "nobody", NULL));
    EXPECT(DGS_STATUS_INVALID_ARGUMENT, "not UTF-8", dgs_world_remove(world, "caf\xe9"));
    EXPECT(DGS_STATUS_NOT_FOUND, "no asset", dgs_world_place(world, "new", UINT32_MAX, &pose, &instance));
    pose.position_m[2] = NAN;
    EXPECT(DGS_STATUS_INVALID_ARGUMENT, "position of agent \"new\"", dgs_world_place(world, "new", 0, &pose, &instance));
    EXPECT(DGS_STATUS_INVALID_ARGUMENT, "time is", dgs_world_set_time(world, NAN));
    OK(dgs_world_place(world, "new", 0, &STANDING, &instance));
    OK(dgs_world_clone(world, &copy));
    OK(dgs_world_remove(world, "new"));
    OK(dgs_world_agent_count(world, &count));
    require(count == before, "who was placed and removed is gone, faults added nobody");
    OK(dgs_world_agent(copy, before, &agent));
    require(agent.instance == instance && agent.pose.position_m[0] == 8.0, "the copy has him still");
    EXPECT(DGS_STATUS_NOT_FOUND, "counted from 0", dgs_world_agent(world, before, &agent));
    OK(dgs_world_close(copy));
    EXPECT(DGS_STATUS_INVALID_HANDLE, "no world", dgs_world_clone(copy, &copy));
    require(copy == NULL, "a handle is NULL where cloning failed");
    OK(dgs_world_close(world));
}

static void misuse_batch_renderers(const DgsSession *session, const DgsScene *scene) {
    DgsSession *other = NULL;
    DgsBatchRenderer *renderer = NULL, *stranger = NULL;
    DgsWorld *world = NULL;
    DgsCamera camera, bad;
    DgsImage image;
    DgsStatistics statistics = {0};
    DgsView view;
    OK(dgs_batch_renderer_new(session, &renderer));
    OK(dgs_world_new(scene, &world));
    OK(dgs_scene_camera_at(scene, 0, 0.0, &camera));
    view.world = world;
    view.cameras = &camera;
    view.camera_count = 1;
    EXPECT(DGS_STATUS_NOT_FOUND, "no images", dgs_batch_renderer_image(renderer, 0, 0, DGS_IMAGE_KIND_RGBA_U8, &image));
    EXPECT(DGS_STATUS_INVALID_ARGUMENT, "no views", dgs_batch_renderer_draw(renderer, &view, 0));
    EXPECT(DGS_STATUS_INVALID_ARGUMENT, "views is NULL", dgs_batch_renderer_draw(renderer, NULL, 1));
    EXPECT(DGS_STATUS_INVALID_ARGUMENT, "more than memory", dgs_batch_renderer_draw(renderer, &view, SIZE_MAX));
    EXPECT(DGS_STATUS_INVALID_ARGUMENT, "not aligned", dgs_batch_renderer_draw(renderer, (const DgsView *)(const void *)((const char *)&view + 1), 1));
    view.camera_count = 0;
    EXPECT(DGS_STATUS_INVALID_ARGUMENT, "view 0 has no cameras", dgs_batch_renderer_draw(renderer, &view, 1));
    view.camera_count = 1;
    view.cameras = &bad;
    bad = camera, bad.width_px = 0;
    EXPECT(DGS_STATUS_INVALID_ARGUMENT, "view 0, camera 0: image size 0x", dgs_batch_renderer_draw(renderer, &view, 1));
    bad = camera, bad.fx_px = NAN;
    EXPECT(DGS_STATUS_INVALID_ARGUMENT, "focal lengths NaN", dgs_batch_renderer_draw(renderer, &view, 1));
    bad = camera, bad.world_from_camera.position_m[0] = NAN;
    EXPECT(DGS_STATUS_INVALID_ARGUMENT, "position of view 0, camera 0", dgs_batch_renderer_draw(renderer, &view, 1));
    view.cameras = &camera;
    view.world = NULL;
    EXPECT(DGS_STATUS_INVALID_HANDLE, "view 0: a world was expected", dgs_batch_renderer_draw(renderer, &view, 1));
    view.world = world;
    OK(dgs_session_open(NULL, &other));
    OK(dgs_batch_renderer_new(other, &stranger));
    EXPECT(DGS_STATUS_INVALID_HANDLE, "another session", dgs_batch_renderer_draw(stranger, &view, 1));
    OK(dgs_batch_renderer_close(stranger));
    OK(dgs_session_close(other));
    OK(dgs_batch_renderer_draw(renderer, &view, 1));
    OK(dgs_batch_renderer_image(renderer, 0, 0, DGS_IMAGE_KIND_RGBA_U8, &image));
    require(image.row_bytes == 4 * (size_t)camera.width_px && image.height_px == camera.height_px, "an image has its size");
    EXPECT(DGS_STATUS_UNSUPPORTED, "no images of this kind", dgs_batch_renderer_image(renderer, 0, 0, DGS_IMAGE_KIND_DEPTH_F32, &image));
    EXPECT(DGS_STATUS_INVALID_ARGUMENT, "kind is 11", dgs_batch_renderer_image(renderer, 0, 0, 11, &image));
    EXPECT(DGS_STATUS_NOT_FOUND, "no camera 1", dgs_batch_renderer_image(renderer, 0, 1, 0, &image));
    EXPECT(DGS_STATUS_NOT_FOUND, "in a view 1", dgs_batch_renderer_image(renderer, 1, 0, 0, &image));
    EXPECT(DGS_STATUS_INVALID_ARGUMENT, "statistics", dgs_batch_renderer_statistics(renderer, &statistics));
    OK(dgs_batch_renderer_close(renderer));
    EXPECT(DGS_STATUS_INVALID_HANDLE, "closed", dgs_batch_renderer_draw(renderer, &view, 1));
    OK(dgs_world_close(world));
}

/* What a thread draws, and what came of it. */
struct task {
    DgsBatchRenderer *renderer;
    DgsView view;
    size_t bytes;
    uint8_t *pixels;
    int failed;
};

static void *draw_some(void *given) {
    struct task *task = given;
    DgsImage image;
    for (int turn = 0; turn < 3; turn++) {
        task->failed |= dgs_batch_renderer_draw(task->renderer, &task->view, 1) != DGS_STATUS_OK;
        task->failed |= dgs_batch_renderer_image(task->renderer, 0, 0, DGS_IMAGE_KIND_RGBA_U8, &image) != DGS_STATUS_OK;
        if (task->failed || image.row_bytes * image.height_px != task->bytes) {
            fprintf(stderr, "a thread could not draw: %s\n", dgs_last_error());
            task->failed = 1;
            return NULL;
        }
        memcpy(task->pixels, image.data, task->bytes);
    }
    /* Faults of one thread are not those of the other. */
    task->failed |= dgs_world_move(NULL, NULL, NULL) == DGS_STATUS_OK || strstr(dgs_last_error(), "NULL") == NULL;
    return NULL;
}

/* Two batch renderers on two threads draw one world, from the cameras that they have; handles are closed in the worst order. */
static void use_two_threads(const char *path) {
    DgsSession *session = NULL;
    DgsScene *scene = NULL;
    DgsWorld *world = NULL;
    DgsCamera cameras[2];
    struct task tasks[3];
    pthread_t threads[2];
    OK(dgs_session_open(NULL, &session));
    OK(dgs_scene_open(session, path, &scene));
    OK(dgs_world_new(scene, &world));
    for (size_t index = 0; index < 3; index++) {
        struct task *task = &tasks[index];
        memset(task, 0, sizeof *task);
        OK(dgs_scene_camera_at(scene, index % 2, 0.0, &cameras[index % 2]));
        OK(dgs_batch_renderer_new(session, &task->renderer));
        task->view.world = world;
        task->view.cameras = &cameras[index % 2];
        task->view.camera_count = 1;
        task->bytes = 4 * (size_t)cameras[index % 2].width_px * cameras[index % 2].height_px;
        task->pixels = malloc(task->bytes);
        require(task->pixels != NULL, "there is memory");
    }
    OK(dgs_session_close(session));
    OK(dgs_scene_close(scene));
    OK(dgs_world_close(NULL));
    for (size_t index = 0; index < 2; index++) {
        require(pthread_create(&threads[index], NULL, draw_some, &tasks[index]) == 0, "a thread begins");
    }
    for (size_t index = 0; index < 2; index++) {
        require(pthread_join(threads[index], NULL) == 0 && !tasks[index].failed, "a thread draws");
    }
    draw_some(&tasks[2]);
    require(!tasks[2].failed && memcmp(tasks[0].pixels, tasks[2].pixels, tasks[0].bytes) == 0, "alone as beside another");
    require(memcmp(tasks[0].pixels, tasks[1].pixels, tasks[0].bytes) != 0, "two cameras see different things");
    OK(dgs_world_close(world));
    for (size_t index = 0; index < 3; index++) {
        OK(dgs_batch_renderer_close(tasks[index].renderer));
        free(tasks[index].pixels);
    }
}

int main(int count, char **arguments) {
    DgsSession *session = NULL;
    DgsScene *scene = NULL;
    if (count != 2) {
        fprintf(stderr, "usage: misuse SCENE.toml\n");
        return 2;
    }
    require(dgs_last_error()[0] == '\0', "nothing is wrong before the first call");
    misuse_devices();
    misuse_options();
    OK(dgs_session_open(NULL, &session));
    misuse_scenes(session, arguments[1]);
    OK(dgs_scene_open(session, arguments[1], &scene));
    misuse_worlds(scene);
    misuse_batch_renderers(session, scene);
    OK(dgs_session_close(session));
    EXPECT(DGS_STATUS_INVALID_HANDLE, "closed", dgs_session_close(session));
    OK(dgs_scene_close(scene));
    use_two_threads(arguments[1]);
    printf("%d failures\n", failures);
    return failures == 0 ? 0 : 1;
}
