/*
 * DecoupleGS: 3D Gaussian Splatting for driving simulation, rendered by Vulkan compute.
 *
 * A session owns a device and the scenes that were opened on it. A scene is a background and the assets that agents show; it is on
 * the device once, however many use it. A world is a set of agents over a scene, and costs a few hundred bytes. A batch renderer draws any
 * number of worlds for any cameras in one call, and keeps the images until its next.
 *
 * Statuses. What can fail returns a DgsStatus. dgs_last_error() says in a sentence what was expected, what was found and what to
 * do. Numbers and structs of a call that failed are not written; handles are set to NULL.
 *
 * Handles. A handle is a number in the clothes of a pointer: it points at nothing, is never given out twice, and one that was
 * closed, invented or of another kind is DGS_STATUS_INVALID_HANDLE. Handles may be closed in any order: what others still need
 * stays alive without its handle. NULL may be closed. Where a fault of the library stopped a call midway (DGS_STATUS_PANIC), the
 * handles of that call can only be closed (DGS_STATUS_POISONED).
 *
 * Threads. Every function may be called from any thread. Sessions and scenes are used by many threads at once. A world may be read
 * and drawn by many at once; a batch renderer is used by one at a time, as is a world that is changed: a second caller does not wait
 * but gets DGS_STATUS_BUSY.
 *
 * Memory. Pointers are NULL only where it says so, and aligned; arrays are as long as the count says. Nothing is kept that a
 * caller's pointer points at. Only the images of dgs_batch_renderer_image() and the points of dgs_batch_renderer_points() belong
 * to the library. When the host's memory is used up the process ends.
 *
 * Text is UTF-8 and ends with a NUL. Text that is returned goes into the caller's buffer, and its length without the NUL into
 * `length`; NULL and 0 for the buffer ask for the length alone.
 *
 * Versions. dgs_abi_version() must be DGS_ABI_VERSION: with another number, structs or functions are others. Structs that may get
 * more fields without that begin with `struct_bytes`, into which the caller writes its sizeof; all other structs stay as they are.
 *
 * Units are meters, seconds and pixels. World: z up. Vehicle and agent: x forward, y left, z up. Camera: x right, y down,
 * z forward. Poses are active: parent = rotation * child + position.
 *
 * This file is made from the sources of the library; edits are lost.
 */

#ifndef DECOUPLEGS_H
#define DECOUPLEGS_H

#include <stddef.h>
#include <stdint.h>

/**
 * The version of functions and structs that this header describes.
 */
#define DGS_ABI_VERSION 1

/**
 * Status of a call. dgs_last_error() has the sentence.
 */
typedef enum {
    /**
     * The call succeeded.
     */
    DGS_STATUS_OK = 0,
    /**
     * NULL, a misaligned pointer, text that is not UTF-8, a number out of range or not finite, a
     * struct of an unknown size.
     */
    DGS_STATUS_INVALID_ARGUMENT = 1,
    /**
     * A handle that was closed, was never given out, is of another kind, or belongs to another
     * session.
     */
    DGS_STATUS_INVALID_HANDLE = 2,
    /**
     * No device, agent, asset, camera or image of that name or number.
     */
    DGS_STATUS_NOT_FOUND = 3,
    /**
     * The buffer is too short for the text: `length` says how long it must be, without the NUL.
     */
    DGS_STATUS_TOO_SMALL = 4,
    /**
     * A limit is reached: agents of a world, splats, or images that are held.
     */
    DGS_STATUS_LIMIT = 5,
    /**
     * Another thread is using the batch renderer or changing the world.
     */
    DGS_STATUS_BUSY = 6,
    /**
     * A file is missing, cannot be read, or is not what its format promises.
     */
    DGS_STATUS_FILE = 7,
    /**
     * No Vulkan loader, driver or device, or the driver refused.
     */
    DGS_STATUS_DEVICE = 8,
    /**
     * The device has not the memory.
     */
    DGS_STATUS_OUT_OF_MEMORY = 9,
    /**
     * The device stopped answering: close everything and open a session anew.
     */
    DGS_STATUS_DEVICE_LOST = 10,
    /**
     * This device, session or agent cannot do it.
     */
    DGS_STATUS_UNSUPPORTED = 11,
    /**
     * A fault of the library, which stopped the call midway. Please report it.
     */
    DGS_STATUS_PANIC = 12,
    /**
     * The handle was in a call that ended with DGS_STATUS_PANIC: it can only be closed.
     */
    DGS_STATUS_POISONED = 13,
} DgsStatus;

/**
 * Storage format of color.
 */
typedef enum {
    /**
     * Four bytes: red, green, blue, clamped to 0 to 1 and rounded, and alpha. What a camera
     * delivers.
     */
    DGS_COLOR_U8 = 0,
    /**
     * Four floats: red, green, blue as blended, unclamped, and alpha.
     */
    DGS_COLOR_F32 = 1,
} DgsColor;

/**
 * Storage of the backgrounds' splats on the device.
 */
typedef enum {
    /**
     * 152 bytes per splat of degree 3.
     */
    DGS_STORAGE_EXACT = 0,
    /**
     * 120 bytes per splat of degree 3, with an error of less than one step of a byte.
     */
    DGS_STORAGE_COMPACT = 1,
} DgsStorage;

/**
 * Content of an image.
 */
typedef enum {
    /**
     * uint8_t red, green, blue, alpha; sessions of DGS_COLOR_U8.
     */
    DGS_IMAGE_KIND_RGBA_U8 = 0,
    /**
     * float red, green, blue, alpha; sessions of DGS_COLOR_F32.
     */
    DGS_IMAGE_KIND_RGBA_F32 = 1,
    /**
     * float: expected depth along the camera's z, meters; 0 where nothing was hit. Sessions with
     * `depth`.
     */
    DGS_IMAGE_KIND_DEPTH_F32 = 2,
    /**
     * uint16_t: the agent that weighs most, by its `instance`; 0 is the background. Sessions with
     * `instance`.
     */
    DGS_IMAGE_KIND_INSTANCE_U16 = 3,
    /**
     * float: expected distance from the camera, meters. This kind and those up to the scene flow
     * are means over the splats of a pixel, and 0 where nothing was hit. Sessions with them in
     * `planes`.
     */
    DGS_IMAGE_KIND_RANGE_F32 = 4,
    /**
     * float x, y, z: normal in world axes, towards the camera; its length tells how far the splats
     * agree.
     */
    DGS_IMAGE_KIND_NORMAL_F32 = 5,
    /**
     * float x, y: pixels that the content moves in `flow_interval_s`. Agents go on with the motion
     * of their trajectory, and rigs with theirs; a DgsCamera stands.
     */
    DGS_IMAGE_KIND_FLOW_FORWARD_F32 = 6,
    /**
     * float x, y: the same to the time earlier.
     */
    DGS_IMAGE_KIND_FLOW_BACKWARD_F32 = 7,
    /**
     * float x, y, z: velocity in world axes, meters per second.
     */
    DGS_IMAGE_KIND_SCENE_FLOW_F32 = 8,
    /**
     * float: depth of the splat in which half of a pixel's light is gone, meters; 0 where more
     * than half is left.
     */
    DGS_IMAGE_KIND_DEPTH_MEDIAN_F32 = 9,
    /**
     * float: distance of that splat from the camera, meters.
     */
    DGS_IMAGE_KIND_RANGE_MEDIAN_F32 = 10,
} DgsImageKind;

/**
 * Kind of a device.
 */
typedef enum {
    /**
     * The driver does not say.
     */
    DGS_DEVICE_KIND_OTHER = 0,
    /**
     * A card with its own memory.
     */
    DGS_DEVICE_KIND_DISCRETE = 1,
    /**
     * Part of the processor, sharing its memory.
     */
    DGS_DEVICE_KIND_INTEGRATED = 2,
    /**
     * Handed through by a hypervisor.
     */
    DGS_DEVICE_KIND_VIRTUAL = 3,
    /**
     * Software on the processor, such as lavapipe.
     */
    DGS_DEVICE_KIND_CPU = 4,
} DgsDeviceKind;

/**
 * Frame of the points of a sweep. Only the motion of the sensor is compensated.
 */
enum DgsPointFrame
#if defined(__cplusplus) || __STDC_VERSION__ >= 202311L
  : uint32_t
#endif // defined(__cplusplus) || __STDC_VERSION__ >= 202311L
 {
    /**
     * The sensor at the end of the sweep: x forward, y left, z up.
     */
    DGS_POINT_FRAME_END = 0,
    /**
     * The sensor at the start of the sweep.
     */
    DGS_POINT_FRAME_START = 1,
    /**
     * The sensor at the firing of each beam.
     */
    DGS_POINT_FRAME_RAW = 2,
    /**
     * The world.
     */
    DGS_POINT_FRAME_WORLD = 3,
};
#ifndef __cplusplus
#if __STDC_VERSION__ >= 202311L
typedef enum DgsPointFrame DgsPointFrame;
#else
typedef uint32_t DgsPointFrame;
#endif // __STDC_VERSION__ >= 202311L
#endif // __cplusplus

/**
 * Kind of range that a beam reports.
 */
enum DgsReturn
#if defined(__cplusplus) || __STDC_VERSION__ >= 202311L
  : uint32_t
#endif // defined(__cplusplus) || __STDC_VERSION__ >= 202311L
 {
    /**
     * Kind of range that the model has.
     */
    DGS_RETURN_OF_MODEL = 0,
    /**
     * Range of the splat at which half of the beam is gone.
     */
    DGS_RETURN_MEDIAN = 1,
    /**
     * Mean range by weight.
     */
    DGS_RETURN_EXPECTED = 2,
    /**
     * Range of the splat that takes most.
     */
    DGS_RETURN_STRONGEST = 3,
    /**
     * Up to two: ranges of the strongest and of the last group of splats.
     */
    DGS_RETURN_DUAL = 4,
};
#ifndef __cplusplus
#if __STDC_VERSION__ >= 202311L
typedef enum DgsReturn DgsReturn;
#else
typedef uint32_t DgsReturn;
#endif // __STDC_VERSION__ >= 202311L
#endif // __cplusplus

/**
 * Draws worlds and keeps the images.
 */
typedef struct DgsBatchRenderer DgsBatchRenderer;

/**
 * The model of a LiDAR.
 */
typedef struct DgsLidar DgsLidar;

/**
 * Cameras of every kind on one vehicle: with lenses, rolling shutters, windshields and photometric
 * calibrations.
 */
typedef struct DgsRig DgsRig;

/**
 * A background, assets, a rig of cameras and a way of the ego vehicle.
 */
typedef struct DgsScene DgsScene;

/**
 * A device and the scenes on it.
 */
typedef struct DgsSession DgsSession;

/**
 * A set of agents over a scene.
 */
typedef struct DgsWorld DgsWorld;

/**
 * A device that Vulkan finds.
 */
typedef struct {
    /**
     * sizeof(DgsDevice), set by the caller.
     */
    uint32_t struct_bytes;
    /**
     * A DgsDeviceKind.
     */
    uint32_t kind;
    /**
     * Size of its largest memory.
     */
    uint64_t memory_bytes;
    /**
     * UUID of the driver, the same for this device in every process and after every start; CUDA
     * names it by the same 16 bytes.
     */
    uint8_t uuid[16];
    /**
     * Name; ends with a NUL.
     */
    char name[256];
    /**
     * The driver's name and version; ends with a NUL.
     */
    char driver[256];
} DgsDevice;

/**
 * Options of a session. All zero but the size is what most want: the best device and images in
 * bytes.
 */
typedef struct {
    /**
     * sizeof(DgsSessionOptions).
     */
    uint32_t struct_bytes;
    /**
     * Storage format of color: a DgsColor.
     */
    uint32_t color;
    /**
     * 1 to have images of depth too, else 0.
     */
    uint32_t depth;
    /**
     * 1 to have images of instances too, else 0.
     */
    uint32_t instance;
    /**
     * Device: a number as in dgs_device(), a part of a name, a UUID as 32 hexadecimal digits, or
     * NULL or "auto" for the best.
     */
    const char *device;
    /**
     * Interval of flow images, seconds; 0 for 0.1.
     */
    double flow_interval_s;
    /**
     * Kinds of further images, DGS_IMAGE_KIND_RANGE_F32 and those behind it: the sum of 1 << kind.
     */
    uint32_t planes;
    /**
     * Storage of the backgrounds' splats: a DgsStorage.
     */
    uint32_t storage;
    /**
     * Backgrounds are drawn with fewer splats where they lie at most this many pixels apart; 0:
     * always the finest, which is exact.
     */
    double background_pitch_px;
    /**
     * Rules of image formation for all scenes: "default", "gsplat15", "gsplat16", "inria" or
     * "nurec"; NULL: each scene's own, as its file says.
     */
    const char *rules;
} DgsSessionOptions;

/**
 * Pose: parent = rotation * child + position.
 */
typedef struct {
    /**
     * Unit quaternion: w, x, y, z.
     */
    double rotation_wxyz[4];
    /**
     * Translation, meters.
     */
    double position_m[3];
} DgsPose;

/**
 * A pinhole camera in the world, without photometric calibration; cameras of every other kind are
 * in a DgsRig. The center of pixel (i, j) is at (i + 0.5, j + 0.5).
 */
typedef struct {
    /**
     * Width of the image, at least 1.
     */
    uint32_t width_px;
    /**
     * Height of the image, at least 1.
     */
    uint32_t height_px;
    /**
     * Focal length along x.
     */
    double fx_px;
    /**
     * Focal length along y.
     */
    double fy_px;
    /**
     * Principal point, from the left edge of the image.
     */
    double cx_px;
    /**
     * Principal point, from the upper edge of the image.
     */
    double cy_px;
    /**
     * Pose of the camera: world from camera.
     */
    DgsPose world_from_camera;
} DgsCamera;

/**
 * An agent as it stands.
 */
typedef struct {
    /**
     * Pose of its origin: world from agent.
     */
    DgsPose pose;
    /**
     * Number of the asset that it shows.
     */
    uint32_t asset;
    /**
     * Id in instance images, above 0.
     */
    uint32_t instance;
} DgsAgent;

/**
 * A world, and the cameras that look at it.
 */
typedef struct {
    /**
     * World to render. The same world may be in many views.
     */
    const DgsWorld *world;
    /**
     * Cameras of the view.
     */
    const DgsCamera *cameras;
    /**
     * Number of cameras; at least one.
     */
    size_t camera_count;
} DgsView;

/**
 * An image in the library's memory: rows from the top, pixels from the left.
 */
typedef struct {
    /**
     * The upper left pixel. Valid until the batch renderer draws or is closed.
     */
    const void *data;
    /**
     * Distance between rows, bytes.
     */
    size_t row_bytes;
    /**
     * Distance between pixels of a row, bytes.
     */
    uint32_t pixel_bytes;
    /**
     * Pixels in a row.
     */
    uint32_t width_px;
    /**
     * Number of rows.
     */
    uint32_t height_px;
    /**
     * A DgsImageKind.
     */
    uint32_t kind;
} DgsImage;

/**
 * Statistics of a draw.
 */
typedef struct {
    /**
     * sizeof(DgsStatistics), set by the caller.
     */
    uint32_t struct_bytes;
    /**
     * Frames that were submitted: one draws up to 32 cameras of worlds over the same scene that
     * follow one another.
     */
    uint32_t frames;
    /**
     * Agents that some camera could see, summed over frames.
     */
    uint32_t agents;
    /**
     * Number of repeated draws because a list outgrew its buffer, which has grown since.
     */
    uint32_t redrawn;
    /**
     * Time on the device, milliseconds, summed over frames; without what ran beside another frame.
     */
    double gpu_ms;
    /**
     * Wall clock of the whole call, milliseconds.
     */
    double wall_ms;
    /**
     * Splats that cameras saw, each counted once for each camera.
     */
    uint64_t splats_listed;
    /**
     * Memory that the session holds on the device.
     */
    uint64_t memory_bytes;
} DgsStatistics;

/**
 * A sweep that is asked for.
 */
typedef struct {
    /**
     * sizeof(DgsSweepOptions).
     */
    uint32_t struct_bytes;
    /**
     * A DgsPointFrame.
     */
    uint32_t frame;
    /**
     * A DgsReturn.
     */
    uint32_t returns;
    /**
     * Share of a beam that splats have to take for a return, above 0 and at most 1; 0 stands for
     * 0.5.
     */
    float opacity_min;
    /**
     * Seed of the noise of ranges, for models that have some.
     */
    uint64_t seed;
    /**
     * Pose of the sensor at the end of the sweep: world from sensor.
     */
    DgsPose world_from_lidar;
    /**
     * Velocity of the sensor during the sweep, along the axes of the world, meters per second.
     */
    double velocity_mps[3];
    /**
     * Rotation vector of the sensor per second, in its own axes, radians per second.
     */
    double turn_rad_per_s[3];
} DgsSweepOptions;

/**
 * A point of a sweep.
 */
typedef struct {
    /**
     * Position in the frame of the sweep, meters.
     */
    float position_m[3];
    /**
     * Range along the beam, meters.
     */
    float range_m;
    /**
     * Intensity from 0 to 1. Luma of splats: uncalibrated.
     */
    float intensity;
    /**
     * Time of firing after the start of the sweep, nanoseconds.
     */
    uint32_t offset_ns;
    /**
     * Column of the beam.
     */
    uint32_t column;
    /**
     * Row of the beam, from the highest.
     */
    uint16_t ring;
    /**
     * Laser of the beam, as the manufacturer counts.
     */
    uint16_t laser;
    /**
     * Number in images of instances; 0 is the background.
     */
    uint16_t instance;
    /**
     * Number among the returns of the beam, from 1.
     */
    uint8_t return_number;
    /**
     * Returns of the beam.
     */
    uint8_t return_count;
} DgsLidarPoint;

/**
 * A world, and a rig that looks at it.
 */
typedef struct {
    /**
     * World to render. The same world may be in many views.
     */
    const DgsWorld *world;
    /**
     * Rig; all its cameras are drawn, in its order.
     */
    const DgsRig *rig;
    /**
     * Pose of the rig: world from rig.
     */
    DgsPose world_from_rig;
    /**
     * Velocity of the rig, along the axes of the world, meters per second. Rolling shutters and
     * images of flow show it.
     */
    double velocity_mps[3];
    /**
     * Rotation vector of the rig per second, in its own axes, radians per second.
     */
    double turn_rad_per_s[3];
} DgsRigView;

#ifdef __cplusplus
extern "C" {
#endif // __cplusplus

/**
 * Message of the last call of this thread that returned a DgsStatus: a sentence, or empty text
 * after success. Never NULL. Valid until this thread's next such call.
 */
const char *dgs_last_error(void);

/**
 * The version of the library's functions and structs. Programs compare it with DGS_ABI_VERSION
 * before anything else.
 */
uint32_t dgs_abi_version(void);

/**
 * The version of the library, such as "0.1.0". Valid for ever.
 */
const char *dgs_version(void);

/**
 * A status in a word or two, such as "invalid handle"; "unknown" for a number that is none. Valid
 * for ever.
 */
const char *dgs_status_name(int32_t status);

/**
 * Writes the number of Vulkan devices, usable or not, to `count`. None is DGS_STATUS_DEVICE.
 */
DgsStatus dgs_device_count(size_t *count);

/**
 * Describes device number `index`, from 0, in `device`, whose `struct_bytes` is set.
 */
DgsStatus dgs_device(size_t index, DgsDevice *device);

/**
 * Opens a device. `options` may be NULL for the best device and images in bytes. With
 * DECOUPLEGS_VALIDATION=1 in the environment the Khronos validation layer watches, which is slow.
 */
DgsStatus dgs_session_open(const DgsSessionOptions *options, DgsSession **session);

/**
 * Closes a session. Scenes, worlds and batch renderers that were made of it go on; the device is
 * let go with the last of them.
 */
DgsStatus dgs_session_close(DgsSession *session);

/**
 * Describes the device of a session in `device`, whose `struct_bytes` is set.
 */
DgsStatus dgs_session_device(const DgsSession *session, DgsDevice *device);

/**
 * Bytes that a session's scenes and batch renderers hold on the device.
 */
DgsStatus dgs_session_memory(const DgsSession *session, uint64_t *bytes);

/**
 * Loads a scene file or a file of splats, unless another handle holds it already: a scene is on
 * the device once, and leaves it when its handles and worlds are closed. Each call gives a handle
 * of its own, to be closed.
 */
DgsStatus dgs_scene_open(const DgsSession *session, const char *path, DgsScene **scene);

/**
 * Closes a handle of a scene. Worlds over the scene go on.
 */
DgsStatus dgs_scene_close(DgsScene *scene);

/**
 * Number of splats of the background.
 */
DgsStatus dgs_scene_splat_count(const DgsScene *scene, size_t *count);

/**
 * Number of cameras of the rig: 0 for a file of splats.
 */
DgsStatus dgs_scene_camera_count(const DgsScene *scene, size_t *count);

/**
 * The name of camera `index` of the rig, from 0. `length` may be NULL.
 */
DgsStatus dgs_scene_camera_name(const DgsScene *scene,
                                size_t index,
                                char *buffer,
                                size_t capacity,
                                size_t *length);

/**
 * Camera `index` of the rig, where it is when the ego vehicle is where the scene file has it at
 * `time_s`.
 */
DgsStatus dgs_scene_camera_at(const DgsScene *scene, size_t index, double time_s, DgsCamera *camera);

/**
 * Camera `index` of the rig, where it is when the ego vehicle is at `ego`, world from ego.
 */
DgsStatus dgs_scene_camera_on(const DgsScene *scene, size_t index, const DgsPose *ego, DgsCamera *camera);

/**
 * Start and end of the ego vehicle's trajectory, seconds. `start_s` and `end_s` are the same where
 * it stands.
 */
DgsStatus dgs_scene_ego_span(const DgsScene *scene, double *start_s, double *end_s);

/**
 * Pose of the ego vehicle at `time_s` from the scene file: world from ego. Before its way begins
 * and after it ends, it stands.
 */
DgsStatus dgs_scene_ego_at(const DgsScene *scene, double time_s, DgsPose *pose);

/**
 * Number of movable agents in the scene file: those that a new world has.
 */
DgsStatus dgs_scene_agent_count(const DgsScene *scene, size_t *count);

/**
 * The name of agent `index` of the scene file, from 0. `length` may be NULL.
 */
DgsStatus dgs_scene_agent_name(const DgsScene *scene,
                               size_t index,
                               char *buffer,
                               size_t capacity,
                               size_t *length);

/**
 * Agent `index` of the scene file, where that has it at `time_s`.
 */
DgsStatus dgs_scene_agent_at(const DgsScene *scene, size_t index, double time_s, DgsAgent *agent);

/**
 * 1 if agent `index` of the scene file is in the scene at `time_s`, otherwise 0.
 */
DgsStatus dgs_scene_agent_present_at(const DgsScene *scene, size_t index, double time_s, uint32_t *present);

/**
 * Number of assets that agents may use.
 */
DgsStatus dgs_scene_asset_count(const DgsScene *scene, size_t *count);

/**
 * Length, width and height of the box of asset number `asset`, from 0, meters, into three floats.
 */
DgsStatus dgs_scene_asset_size(const DgsScene *scene, uint32_t asset, float *size_m);

/**
 * Copies another compressed asset (.safetensors) to the device, for all worlds over this scene.
 * Its number goes into `asset`.
 */
DgsStatus dgs_scene_add_asset(const DgsScene *scene, const char *path, uint32_t *asset);

/**
 * A world with the agents of the scene file, where they are at time 0.
 */
DgsStatus dgs_world_new(const DgsScene *scene, DgsWorld **world);

/**
 * A world without agents.
 */
DgsStatus dgs_world_new_empty(const DgsScene *scene, DgsWorld **world);

/**
 * Another world with agents as those of `world` are now. Over the same scene, they go their own
 * ways from here on.
 */
DgsStatus dgs_world_clone(const DgsWorld *world, DgsWorld **copy);

/**
 * Closes a world.
 */
DgsStatus dgs_world_close(DgsWorld *world);

/**
 * Puts the agents of the scene file that are still here where that has them at `time_s`.
 */
DgsStatus dgs_world_set_time(DgsWorld *world, double time_s);

/**
 * Moves the agent called `name`. One of plain splats is part of the background and cannot be
 * moved: DGS_STATUS_UNSUPPORTED.
 */
DgsStatus dgs_world_move(DgsWorld *world, const char *name, const DgsPose *pose);

/**
 * Adds an agent called `name` that shows asset number `asset`, or lets the one of that name show
 * it. Its number in images of instances goes into `instance`, which may be NULL.
 */
DgsStatus dgs_world_place(DgsWorld *world,
                          const char *name,
                          uint32_t asset,
                          const DgsPose *pose,
                          uint32_t *instance);

/**
 * Takes the agent called `name` out.
 */
DgsStatus dgs_world_remove(DgsWorld *world, const char *name);

/**
 * Number of agents of a world.
 */
DgsStatus dgs_world_agent_count(const DgsWorld *world, size_t *count);

/**
 * The name of agent `index` of a world, from 0. `length` may be NULL. Removing an agent renumbers
 * those behind it.
 */
DgsStatus dgs_world_agent_name(const DgsWorld *world,
                               size_t index,
                               char *buffer,
                               size_t capacity,
                               size_t *length);

/**
 * Agent `index` of a world, from 0, as it stands.
 */
DgsStatus dgs_world_agent(const DgsWorld *world, size_t index, DgsAgent *agent);

/**
 * 1 if agent `index` of a world is in its images, 0 where the scene file says that it is absent.
 */
DgsStatus dgs_world_agent_present(const DgsWorld *world, size_t index, uint32_t *present);

/**
 * A batch renderer that draws as the session's options say. One for each thread that draws, and
 * one for each use, is fastest: it keeps its memory from draw to draw.
 */
DgsStatus dgs_batch_renderer_new(const DgsSession *session, DgsBatchRenderer **renderer);

/**
 * Closes a batch renderer. Its images go with it.
 */
DgsStatus dgs_batch_renderer_close(DgsBatchRenderer *renderer);

/**
 * Draws `count` views, at least one, and waits for the images. Worlds over one scene that follow
 * one another are drawn together, 32 cameras at a time. Where it fails, the batch renderer has no
 * images and is as good as before.
 */
DgsStatus dgs_batch_renderer_draw(DgsBatchRenderer *renderer, const DgsView *views, size_t count);

/**
 * The image that camera `camera` of view `view` of the last draw took, both from 0; `kind` is a
 * DgsImageKind. The pixels stay until the batch renderer draws or is closed.
 */
DgsStatus dgs_batch_renderer_image(const DgsBatchRenderer *renderer,
                                   size_t view,
                                   size_t camera,
                                   uint32_t kind,
                                   DgsImage *image);

/**
 * Writes the statistics of the last successful draw to `statistics`, whose `struct_bytes` is set.
 */
DgsStatus dgs_batch_renderer_statistics(const DgsBatchRenderer *renderer, DgsStatistics *statistics);

/**
 * The model called `sensor` that comes with the library, such as "pandar128", or that of a file
 * (.toml, or the parameters of NVIDIA NCore as .json).
 */
DgsStatus dgs_lidar_open(const char *sensor, DgsLidar **lidar);

/**
 * Closes a LiDAR.
 */
DgsStatus dgs_lidar_close(DgsLidar *lidar);

/**
 * Number of LiDARs of a scene's rig: 0 for a file of splats.
 */
DgsStatus dgs_scene_lidar_count(const DgsScene *scene, size_t *count);

/**
 * LiDAR `index` of a scene's rig, from 0, to be closed, and its pose on the vehicle.
 */
DgsStatus dgs_scene_lidar(const DgsScene *scene, size_t index, DgsLidar **lidar, DgsPose *rig_from_lidar);

/**
 * Beams of a LiDAR's sweep: no sweep has more points.
 */
DgsStatus dgs_lidar_beam_count(const DgsLidar *lidar, size_t *count);

/**
 * Duration of a LiDAR's sweep, seconds.
 */
DgsStatus dgs_lidar_sweep_s(const DgsLidar *lidar, double *sweep_s);

/**
 * Traces one sweep of a LiDAR through a world and waits for it. Agents are where the world has
 * them at the end of the sweep. Its points replace those of the sweep before.
 */
DgsStatus dgs_batch_renderer_sweep(DgsBatchRenderer *renderer,
                                   const DgsWorld *world,
                                   const DgsLidar *lidar,
                                   const DgsSweepOptions *options);

/**
 * The points of the last sweep, in the order of firing. They stay until the batch renderer traces
 * another sweep or is closed.
 */
DgsStatus dgs_batch_renderer_points(const DgsBatchRenderer *renderer,
                                    const DgsLidarPoint **points,
                                    size_t *count);

/**
 * The rig that a text describes, to be closed: TOML with the [[rig]] tables of a scene file, or
 * JSON: such a table as an object, an array of them, or an object whose "rig" is that array. The
 * keys are those of engine/asset/scene-file.md: width_px, height_px, fx_px, fy_px, cx_px, cy_px,
 * position_m, rotation_wxyz or look, lens, shutter, photometry, windshield, name. The first three
 * are needed; a camera without the others is a pinhole at the origin of the rig.
 */
DgsStatus dgs_rig_from_text(const char *description, DgsRig **rig);

/**
 * The cameras of a scene's own rig, to be closed; NOT_FOUND for a file of splats.
 */
DgsStatus dgs_scene_rig(const DgsScene *scene, DgsRig **rig);

/**
 * Closes a rig.
 */
DgsStatus dgs_rig_close(DgsRig *rig);

/**
 * Number of cameras of a rig.
 */
DgsStatus dgs_rig_camera_count(const DgsRig *rig, size_t *count);

/**
 * The name of camera `index` of a rig, from 0. `length` may be NULL.
 */
DgsStatus dgs_rig_camera_name(const DgsRig *rig, size_t index, char *buffer, size_t capacity, size_t *length);

/**
 * Draws `count` views of rigs, at least one, as dgs_batch_renderer_draw() draws views of pinholes.
 * Camera `index` of a view's images is that of its rig.
 */
DgsStatus dgs_batch_renderer_draw_rigs(DgsBatchRenderer *renderer, const DgsRigView *views, size_t count);

/**
 * A pinhole that looks from `eye` at `target`, with `up` up in its image: three doubles each,
 * meters. `fov_rad` is the horizontal field of view, above 0 and below pi.
 */
DgsStatus dgs_camera_look_at(uint32_t width_px,
                             uint32_t height_px,
                             double fov_rad,
                             const double *eye,
                             const double *target,
                             const double *up,
                             DgsCamera *camera);

/**
 * A pinhole that shows all splats of a splat file: the middle 90 % of them on each axis. It stands
 * towards `direction`, with `up` up in its image: three doubles each, or NULL for what `decouplegs
 * render` has, with -y up for splat files. Scenes with cameras of their own are NOT_FOUND.
 */
DgsStatus dgs_scene_frame(const DgsScene *scene,
                          uint32_t width_px,
                          uint32_t height_px,
                          const double *direction,
                          const double *up,
                          DgsCamera *camera);

/**
 * Writes an image of DGS_IMAGE_KIND_RGBA_U8 to a PNG file: red, green and blue. The file is there
 * whole or not at all, and replaces one that was there.
 */
DgsStatus dgs_save_png(const char *path, const DgsImage *image);

#ifdef __cplusplus
}  // extern "C"
#endif  // __cplusplus

#endif  /* DECOUPLEGS_H */
