/* spgs: dynamic 3D Gaussian scenes inside another program, on its own Vulkan device.
 *
 * The calls are those of the Rust API (engine::gpu::host, engine::render::embed), whose documentation says more. In short:
 *
 *   once:          spgs_gpu_from_host  (or spgs_gpu_create: the engine makes the device)
 *                  spgs_scene_load     (or spgs_scene_load_async)
 *                  spgs_view_create, spgs_view_warm_up
 *   every frame:   spgs_view_record into a command buffer that is being recorded, outside of a render pass
 *   in the end:    wait for the device, spgs_view_destroy, spgs_scene_destroy, spgs_gpu_destroy
 *
 * Errors. Every call that can fail returns a status; when it is not SPGS_OK, spgs_message() has the text, and what the call
 * was to write is not written. No call unwinds or aborts: a defect inside the engine is SPGS_PANIC, after which the objects of
 * that call should only be destroyed. Null where an object is expected is SPGS_USAGE; destroying null does nothing.
 *
 * Threads. An spgs_gpu and an spgs_scene may be used by several threads at once. An spgs_view may move between threads, but one call
 * at a time; different views may be recorded at the same time into command buffers of different pools. spgs_message() belongs
 * to the calling thread.
 *
 * Synchronisation. spgs_view_record submits nothing, waits for nothing, and, once a view has seen its size and its largest
 * frame, allocates nothing. It waits on the device for what spgs_image names before, moves the image to
 * TRANSFER_DST_OPTIMAL (GENERAL when it is written through a view), writes it, and moves it to new_layout, visible to what
 * spgs_image names after. Semaphores are the host's; for a swapchain, wait for the acquisition at stage TRANSFER, or
 * COMPUTE_SHADER when the image is written through a view (storage), and name that stage in before_stages, so that the change of
 * layout waits for it too. Command buffers that share a view must execute one after another, and so must those that share a scene
 * with network F or G or a deformation field, whose results lie in buffers of the scene (spgs_scene_extent.one_after_another says
 * so). Views, scenes and images stay until the commands that use them have finished.
 *
 * Stability. From version 1.0 on, semantic versioning: within a major version nothing changes its meaning or goes away;
 * structures that begin with struct_size may grow at their end. Set struct_size = sizeof(the structure) and zero the
 * rest: zero is the default of every field that says nothing else.
 */
#ifndef SPGS_H
#define SPGS_H

#include <stdint.h>

#if defined(_WIN32)
#define SPGS_API __declspec(dllimport)
#else
#define SPGS_API
#endif

#ifdef __cplusplus
extern "C" {
#endif

/* ---- Status ---------------------------------------------------------------------------------------------------------- */

typedef int32_t spgs_status;
enum {
    SPGS_OK = 0,
    SPGS_ERROR = 1,       /* no usable device, a failed Vulkan call */
    SPGS_USAGE = 2,       /* an argument without sense */
    SPGS_BAD_DATA = 3,    /* a malformed or unreadable file */
    SPGS_LIMIT = 4,       /* a limit or out of memory */
    SPGS_DEVICE_LOST = 5,
    SPGS_NOT_FINITE = 6,  /* a NaN or infinite number */
    SPGS_PANIC = 7,       /* a defect of the engine, caught */
    SPGS_NOT_READY = 8    /* spgs_loading_poll: still at work */
};

/* Text of the last error of this thread: one line, UTF-8, never null; valid until the thread's next call. */
SPGS_API const char *spgs_message(void);

/* Version of the library: major << 16 | minor << 8 | patch. */
SPGS_API uint32_t spgs_version(void);

/* ---- Device ---------------------------------------------------------------------------------------------------------- */

typedef struct spgs_gpu spgs_gpu;

/* Device extensions that a host must enable for an instance of this api_version: sets count, and names to an array that lives
 * as long as the program. VK_KHR_portability_subset is needed too where a device has it. */
SPGS_API spgs_status spgs_required_extensions(uint32_t api_version, const char *const **names, uint32_t *count);

/* Members of VkPhysicalDevice...Features that must be true, as above. */
SPGS_API spgs_status spgs_required_features(const char *const **names, uint32_t *count);

/* A host's device. Everything outlives the spgs_gpu; nothing of it is destroyed. */
typedef struct spgs_host {
    uint32_t struct_size;
    uint32_t api_version;     /* VkApplicationInfo::apiVersion, at least 1.2 */
    void (*get_instance_proc_addr)(void); /* PFN_vkGetInstanceProcAddr; null: the system's loader */
    void *instance;           /* VkInstance */
    void *physical_device;    /* VkPhysicalDevice */
    void *device;             /* VkDevice */
    void *queue;              /* VkQueue for uploads; a second queue of the family needs no lock */
    uint32_t queue_family;    /* its family, and that of the command buffers; with compute */
    uint32_t reserved;
    /* Taken around each of the engine's submissions (uploads, warming up). Null: nobody submits to the queue meanwhile. */
    void (*lock_queue)(void *lock_user);
    void (*unlock_queue)(void *lock_user);
    void *lock_user;
} spgs_host;

SPGS_API spgs_status spgs_gpu_from_host(const spgs_host *host, spgs_gpu **gpu);

/* The engine makes instance and device. device_name: index or part of a name, null for the fastest kind. The extensions are
 * enabled beside the engine's own, for a window's surface.
 *
 * At its first use with a driver a device is tested as spgs_gpu_self_test says, each kind of kernel when it is first needed
 * (then by the function that needs it), and the verdict is kept in the user's cache folder. One that fails is SPGS_ERROR if device_name names it, else the next one is taken. skip_self_test (or the environment
 * variable SPGS_SELF_TEST=0) takes the device as it is. */
typedef struct spgs_gpu_options {
    uint32_t struct_size;
    uint32_t instance_extension_count;
    uint32_t device_extension_count;
    uint32_t validation;      /* not 0: with the Khronos validation layer */
    const char *device_name;
    const char *const *instance_extensions;
    const char *const *device_extensions;
    uint32_t skip_self_test;  /* not 0: the device is not tested */
    uint32_t reserved;
} spgs_gpu_options;

/* options may be null. The queue of the device draws too, where the device has such a queue. */
SPGS_API spgs_status spgs_gpu_create(const spgs_gpu_options *options, spgs_gpu **gpu);

/* Tests now whether the device computes what it must: the kernels that play scenes, on small ones. For a host's device, which is
 * not tested otherwise. Blocks for a fraction of a second, longer while the driver compiles kernels for the first time; nothing else
 * is recorded or submitted with this spgs_gpu meanwhile. SPGS_ERROR when it fails: spgs_message() names the kernel and the
 * difference. */
SPGS_API spgs_status spgs_gpu_self_test(const spgs_gpu *gpu);

typedef struct spgs_handles {
    void *instance;
    void *physical_device;
    void *device;
    uint32_t queue_family;
    uint32_t reserved;
} spgs_handles;

SPGS_API spgs_status spgs_gpu_handles(const spgs_gpu *gpu, spgs_handles *handles);

/* Calls submit with the VkQueue while nobody else, the engine included, submits to it. No call of this library inside. */
SPGS_API spgs_status spgs_gpu_with_queue(const spgs_gpu *gpu, void (*submit)(void *queue, void *user), void *user);

/* Objects made from it keep what they need, so the order of destruction is free; of a host's device, all of them go before
 * the device does. */
SPGS_API void spgs_gpu_destroy(spgs_gpu *gpu);

/* ---- Scenes ---------------------------------------------------------------------------------------------------------- */

typedef struct spgs_scene spgs_scene;
typedef struct spgs_loading spgs_loading;

enum { SPGS_MOTION_AUTO = 0, SPGS_MOTION_TABLE = 1, SPGS_MOTION_NETWORK = 2 };
enum { SPGS_QUALITY_EXACT = 0, SPGS_QUALITY_HIGH = 1 };

typedef struct spgs_scene_options {
    uint32_t struct_size;
    uint32_t motion;          /* SPGS_MOTION_... */
    uint32_t quality;         /* SPGS_QUALITY_... */
    uint32_t reserved;
} spgs_scene_options;

/* Reads a model (.safetensors, 3DGS .ply, or any other file or folder that `spgs convert` reads) and uploads it; blocks. options
 * may be null. */
SPGS_API spgs_status spgs_scene_load(
    const spgs_gpu *gpu, const char *path, const spgs_scene_options *options, spgs_scene **scene);

/* The engine's built-in moving scene. */
SPGS_API spgs_status spgs_scene_demo(const spgs_gpu *gpu, const spgs_scene_options *options, spgs_scene **scene);

/* The same on a thread of the engine's. */
SPGS_API spgs_status spgs_scene_load_async(
    const spgs_gpu *gpu, const char *path, const spgs_scene_options *options, spgs_loading **loading);

/* SPGS_NOT_READY as long as the thread is at work, then SPGS_OK. */
SPGS_API spgs_status spgs_loading_poll(const spgs_loading *loading);

/* The scene; blocks until it is there. loading is gone afterwards, whatever is returned. */
SPGS_API spgs_status spgs_loading_finish(spgs_loading *loading, spgs_scene **scene);

/* Gives up a scene that is being loaded; its thread ends by itself. */
SPGS_API void spgs_loading_cancel(spgs_loading *loading);

typedef struct spgs_scene_info {
    uint64_t gaussians;       /* of the model, the refused ones included */
    uint64_t rejected;        /* refused when it was read or uploaded: not finite, no rotation, absurd size, out of range */
    uint64_t bytes;           /* of device memory */
} spgs_scene_info;

SPGS_API spgs_status spgs_scene_get_info(const spgs_scene *scene, spgs_scene_info *info);

/* Where and when a scene is. */
typedef struct spgs_scene_extent {
    double first_time;        /* of the key-time table that moves it; 0 and 1 where a network or a deformation field does, */
    double last_time;         /* which are trained on that; both 0 when it stands still */
    double center[3];         /* of a ball that holds most of it: on each axis the median of the Gaussians' centres, world units. */
                              /* Where a table moves them those at its first, middle and last key count, else those at rest. */
    double radius;            /* 90 % of those centres lie within it; 0 without Gaussians. Of a large scene, 65,536 Gaussians */
                              /* at even steps of their index stand for all. */
    uint32_t motion;          /* SPGS_MOTION_TABLE, SPGS_MOTION_NETWORK (deformation fields too), or 0: it stands still */
    uint32_t one_after_another; /* not 0: command buffers of all views of it execute one after another, see above */
} spgs_scene_extent;

SPGS_API spgs_status spgs_scene_get_extent(const spgs_scene *scene, spgs_scene_extent *extent);

/* What reading the model warned of, one line each (Gaussians that are skipped, which level of detail was read, ...): sets count,
 * and warnings to an array that lives as long as the scene. */
SPGS_API spgs_status spgs_scene_warnings(const spgs_scene *scene, const char *const **warnings, uint32_t *count);

SPGS_API void spgs_scene_destroy(spgs_scene *scene);

/* ---- Views ----------------------------------------------------------------------------------------------------------- */

typedef struct spgs_view spgs_view;

/* Axes of the camera: x right, y down, z forward; pixel centres at +0.5. */
typedef struct spgs_camera {
    uint32_t width, height;   /* of the image, pixels */
    double fx, fy, cx, cy;    /* focal lengths and principal point, pixels */
    double world_to_camera[16]; /* column-major: camera = M * world. Rigid: refused unless the rotation's columns are orthonormal,
                                   its determinant 1 and the last row 0, 0, 0, 1, within 0.001 */
} spgs_camera;

enum { SPGS_RGBA8 = 0, SPGS_BGRA8 = 1, SPGS_RGBA16F = 2, SPGS_RGBA32F = 3 };

typedef struct spgs_view_options {
    uint32_t struct_size;
    uint32_t format;          /* of the colour image, SPGS_RGBA8 ... */
    uint32_t depth;           /* not 0: depth is rendered too */
    uint32_t in_flight;       /* calls of spgs_view_record that may be unfinished when the next is made, plus one; 0: 2; at most 16.
                                 When record is called for the (k + in_flight)-th time, the k-th call's commands have finished. */
    uint64_t max_instances;   /* 0: what the device holds */
    float background[3];      /* black for premultiplied colour */
    float near_plane;         /* world units; 0: 0.2 */
    uint32_t storage;         /* not 0: the colour image is written through storage_view, not copied to; not with SPGS_BGRA8 */
    uint32_t reserved;
} spgs_view_options;

/* The scene is one of the same spgs_gpu. */
SPGS_API spgs_status spgs_view_create(
    const spgs_gpu *gpu, const spgs_scene *scene, const spgs_view_options *options, spgs_view **view);

/* An image with usage TRANSFER_DST (STORAGE when it is written through a view), one sample, colour aspect, at least as large as
 * the camera's. Layouts, stages and accesses are values of VkImageLayout, VkPipelineStageFlags2 and VkAccessFlags2. */
typedef struct spgs_image {
    uint64_t image;           /* VkImage */
    uint32_t x, y;            /* first pixel that is written */
    uint32_t layer, level;
    int32_t old_layout;       /* its layout, or VK_IMAGE_LAYOUT_UNDEFINED when its content may go */
    int32_t new_layout;       /* its layout afterwards; neither UNDEFINED nor PREINITIALIZED */
    uint64_t before_stages, before_access; /* earlier uses that are waited for */
    uint64_t after_stages, after_access;   /* later uses that see the pixels */
    uint64_t storage_view;    /* VkImageView, 2D, of that layer and level and of the view's format; 0 unless the view has storage.
                                 It stays until the commands have finished. */
} spgs_image;

/* Colour: sum of c alpha T + T background, A = 1 - T. Depth (R32_SFLOAT, null for none): sum of z alpha T, camera-space z;
 * divided by A it is the mean depth, to be tested against meshes. */
typedef struct spgs_target {
    spgs_image color;
    const spgs_image *depth;
} spgs_target;

typedef struct spgs_statistics {
    uint32_t visible;         /* Gaussians that touch the image */
    uint32_t rejected;        /* of those on the device, not finite in this frame or refused on upload */
    uint64_t instances;       /* (Gaussian, tile) pairs */
} spgs_statistics;

/* An earlier frame, looked at when it was sure to have finished. */
typedef struct spgs_finished {
    uint64_t serial;          /* number of its call of record, from 1 (warming up does not count); 0: none yet */
    spgs_statistics statistics;
    uint32_t overflowed;      /* not 0: it lacked room and shows the background only; there is room now */
    uint32_t reserved;
} spgs_finished;

/* Runs frames without an image until one fits the view's buffers, so that none is lost to their growth; blocks. Nothing that
 * this view recorded may be in flight. statistics may be null. */
SPGS_API spgs_status spgs_view_warm_up(
    spgs_view *view, const spgs_camera *camera, double time, spgs_statistics *statistics);

/* Records a frame into command_buffer (VkCommandBuffer, recording, outside of a render pass). finished may be null.
 *
 * time has the unit of the scene's motion (first_time and last_time of spgs_scene_extent) and may be any number that is finite as
 * a float, else SPGS_NOT_FINITE. Before the first key of a table and after the last the pose there is held; a network or a
 * deformation field is evaluated at that very time, about which training said nothing beyond 0 and 1. */
SPGS_API spgs_status spgs_view_record(spgs_view *view, void *command_buffer, const spgs_camera *camera, double time,
    const spgs_target *target, spgs_finished *finished);

/* Says that everything recorded so far has finished: replaced buffers are freed. finished may be null. */
SPGS_API spgs_status spgs_view_all_finished(spgs_view *view, spgs_finished *finished);

/* Shows another scene of the same spgs_gpu from the next call on. */
SPGS_API spgs_status spgs_view_set_scene(spgs_view *view, const spgs_scene *scene);

/* What it recorded has finished. */
SPGS_API void spgs_view_destroy(spgs_view *view);

#ifdef __cplusplus
}
#endif
#endif
