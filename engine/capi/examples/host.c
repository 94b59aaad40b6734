/* A C program with its own Vulkan device that draws a mesh, and our scene among it.
 *
 *   cc -std=c11 host.c -I../include -L DIR_OF_LIBSPGS -lspgs -lvulkan -lm -o host
 *   ./host SHADER_DIR OUT.ppm [WIDTH HEIGHT]        (SHADER_DIR: engine/examples/shaders)
 *
 * It is the twin of engine/examples/host: main() is the part that concerns the engine; what is above it is what any
 * program has. SPGS_VALIDATION=1 turns the validation layer on; a message of it makes the program fail. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <vulkan/vulkan.h>

#include "spgs.h"

#define NEAR_PLANE 0.1
#define FAR_PLANE 100.0
#define LENGTH(array) ((uint32_t)(sizeof(array) / sizeof((array)[0])))

static unsigned messages = 0;

static void fail(const char *what, const char *why) {
    fprintf(stderr, "host: %s: %s\n", what, why);
    exit(1);
}

static void vk(VkResult result, const char *what) {
    if (result != VK_SUCCESS) {
        char text[32];
        snprintf(text, sizeof text, "VkResult %d", (int)result);
        fail(what, text);
    }
}

static void spgs(spgs_status status, const char *what) {
    if (status != SPGS_OK) {
        fail(what, spgs_message());
    }
}

/* ---- The host's own Vulkan ------------------------------------------------------------------------------------------- */

typedef struct {
    VkInstance instance;
    VkDebugUtilsMessengerEXT messenger;
    VkPhysicalDevice physical;
    VkDevice device;
    uint32_t family;
    VkQueue queue;
    VkCommandPool pool;
    VkCommandBuffer commands;
} Host;

typedef struct {
    VkImage image;
    VkDeviceMemory memory;
    VkImageView view;
} Picture;

static VKAPI_ATTR VkBool32 VKAPI_CALL on_message(VkDebugUtilsMessageSeverityFlagBitsEXT severity,
    VkDebugUtilsMessageTypeFlagsEXT kind, const VkDebugUtilsMessengerCallbackDataEXT *data, void *user) {
    (void)severity;
    (void)kind;
    (void)user;
    fprintf(stderr, "validation layer: %s\n", data->pMessage);
    messages++;
    return VK_FALSE;
}

static void create_instance(Host *host, int validation) {
    VkApplicationInfo app = {.sType = VK_STRUCTURE_TYPE_APPLICATION_INFO, .apiVersion = VK_API_VERSION_1_3};
    const char *layers[] = {"VK_LAYER_KHRONOS_validation"};
    const char *extensions[] = {VK_EXT_DEBUG_UTILS_EXTENSION_NAME, VK_EXT_VALIDATION_FEATURES_EXTENSION_NAME};
    VkValidationFeatureEnableEXT enabled[] = {VK_VALIDATION_FEATURE_ENABLE_SYNCHRONIZATION_VALIDATION_EXT};
    VkValidationFeaturesEXT features = {.sType = VK_STRUCTURE_TYPE_VALIDATION_FEATURES_EXT,
        .enabledValidationFeatureCount = LENGTH(enabled),
        .pEnabledValidationFeatures = enabled};
    VkInstanceCreateInfo create = {.sType = VK_STRUCTURE_TYPE_INSTANCE_CREATE_INFO,
        .pNext = validation ? &features : NULL,
        .pApplicationInfo = &app,
        .enabledLayerCount = validation ? 1 : 0,
        .ppEnabledLayerNames = layers,
        .enabledExtensionCount = validation ? 2 : 0,
        .ppEnabledExtensionNames = extensions};
    vk(vkCreateInstance(&create, NULL, &host->instance), "vkCreateInstance");
    if (validation) {
        VkDebugUtilsMessengerCreateInfoEXT messenger = {
            .sType = VK_STRUCTURE_TYPE_DEBUG_UTILS_MESSENGER_CREATE_INFO_EXT,
            .messageSeverity =
                VK_DEBUG_UTILS_MESSAGE_SEVERITY_ERROR_BIT_EXT | VK_DEBUG_UTILS_MESSAGE_SEVERITY_WARNING_BIT_EXT,
            .messageType = VK_DEBUG_UTILS_MESSAGE_TYPE_VALIDATION_BIT_EXT,
            .pfnUserCallback = on_message};
        PFN_vkCreateDebugUtilsMessengerEXT make = (PFN_vkCreateDebugUtilsMessengerEXT)vkGetInstanceProcAddr(
            host->instance, "vkCreateDebugUtilsMessengerEXT");
        vk(make(host->instance, &messenger, NULL, &host->messenger), "vkCreateDebugUtilsMessengerEXT");
    }
}

static void create_device(Host *host) {
    VkPhysicalDevice devices[16];
    uint32_t count = LENGTH(devices);
    if (vkEnumeratePhysicalDevices(host->instance, &count, devices) < 0 || count == 0) {
        fail("device", "none found");
    }
    const char *wanted = getenv("SPGS_DEVICE");
    host->physical = VK_NULL_HANDLE;
    for (uint32_t i = 0; i < count && host->physical == VK_NULL_HANDLE; i++) {
        VkPhysicalDeviceProperties properties;
        vkGetPhysicalDeviceProperties(devices[i], &properties);
        int named = wanted == NULL || strstr(properties.deviceName, wanted) != NULL;
        if (properties.apiVersion >= VK_API_VERSION_1_3 && named) {
            host->physical = devices[i];
        }
    }
    if (host->physical == VK_NULL_HANDLE) {
        fail("device", "none with Vulkan 1.3");
    }
    VkQueueFamilyProperties families[16];
    count = LENGTH(families);
    vkGetPhysicalDeviceQueueFamilyProperties(host->physical, &count, families);
    VkQueueFlags both = VK_QUEUE_GRAPHICS_BIT | VK_QUEUE_COMPUTE_BIT;
    for (host->family = 0; (families[host->family].queueFlags & both) != both; host->family++) {
        if (host->family + 1 == count) {
            fail("device", "no queue for graphics and compute");
        }
    }
    /* What spgs_required_extensions and spgs_required_features list, and dynamicRendering for the host itself. */
    const char *const *extensions;
    uint32_t extension_count;
    spgs(spgs_required_extensions(VK_API_VERSION_1_3, &extensions, &extension_count), "required extensions");
    VkPhysicalDeviceVulkan13Features vulkan_13 = {.sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_VULKAN_1_3_FEATURES,
        .synchronization2 = VK_TRUE,
        .subgroupSizeControl = VK_TRUE,
        .computeFullSubgroups = VK_TRUE,
        .dynamicRendering = VK_TRUE};
    VkPhysicalDeviceVulkan12Features vulkan_12 = {.sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_VULKAN_1_2_FEATURES,
        .pNext = &vulkan_13,
        .timelineSemaphore = VK_TRUE};
    float priority = 1.0f;
    VkDeviceQueueCreateInfo queue = {.sType = VK_STRUCTURE_TYPE_DEVICE_QUEUE_CREATE_INFO,
        .queueFamilyIndex = host->family,
        .queueCount = 1,
        .pQueuePriorities = &priority};
    VkDeviceCreateInfo create = {.sType = VK_STRUCTURE_TYPE_DEVICE_CREATE_INFO,
        .pNext = &vulkan_12,
        .queueCreateInfoCount = 1,
        .pQueueCreateInfos = &queue,
        .enabledExtensionCount = extension_count,
        .ppEnabledExtensionNames = extensions};
    vk(vkCreateDevice(host->physical, &create, NULL, &host->device), "vkCreateDevice");
    vkGetDeviceQueue(host->device, host->family, 0, &host->queue);
    VkCommandPoolCreateInfo pool = {
        .sType = VK_STRUCTURE_TYPE_COMMAND_POOL_CREATE_INFO, .queueFamilyIndex = host->family};
    vk(vkCreateCommandPool(host->device, &pool, NULL, &host->pool), "vkCreateCommandPool");
    VkCommandBufferAllocateInfo allocate = {.sType = VK_STRUCTURE_TYPE_COMMAND_BUFFER_ALLOCATE_INFO,
        .commandPool = host->pool,
        .level = VK_COMMAND_BUFFER_LEVEL_PRIMARY,
        .commandBufferCount = 1};
    vk(vkAllocateCommandBuffers(host->device, &allocate, &host->commands), "vkAllocateCommandBuffers");
}

static VkDeviceMemory allocate(const Host *host, VkMemoryRequirements needs, VkMemoryPropertyFlags flags) {
    VkPhysicalDeviceMemoryProperties properties;
    vkGetPhysicalDeviceMemoryProperties(host->physical, &properties);
    uint32_t type = 0;
    while (type < properties.memoryTypeCount
        && (!(needs.memoryTypeBits >> type & 1) || (properties.memoryTypes[type].propertyFlags & flags) != flags)) {
        type++;
    }
    VkMemoryAllocateInfo info = {
        .sType = VK_STRUCTURE_TYPE_MEMORY_ALLOCATE_INFO, .allocationSize = needs.size, .memoryTypeIndex = type};
    VkDeviceMemory memory;
    vk(vkAllocateMemory(host->device, &info, NULL, &memory), "vkAllocateMemory");
    return memory;
}

static Picture create_picture(const Host *host, VkExtent3D size, VkFormat format, VkImageUsageFlags usage) {
    Picture picture;
    VkImageCreateInfo create = {.sType = VK_STRUCTURE_TYPE_IMAGE_CREATE_INFO,
        .imageType = VK_IMAGE_TYPE_2D,
        .format = format,
        .extent = size,
        .mipLevels = 1,
        .arrayLayers = 1,
        .samples = VK_SAMPLE_COUNT_1_BIT,
        .usage = usage};
    vk(vkCreateImage(host->device, &create, NULL, &picture.image), "vkCreateImage");
    VkMemoryRequirements needs;
    vkGetImageMemoryRequirements(host->device, picture.image, &needs);
    picture.memory = allocate(host, needs, 0);
    vk(vkBindImageMemory(host->device, picture.image, picture.memory, 0), "vkBindImageMemory");
    VkImageAspectFlags aspect =
        format == VK_FORMAT_D32_SFLOAT ? VK_IMAGE_ASPECT_DEPTH_BIT : VK_IMAGE_ASPECT_COLOR_BIT;
    VkImageViewCreateInfo view = {.sType = VK_STRUCTURE_TYPE_IMAGE_VIEW_CREATE_INFO,
        .image = picture.image,
        .viewType = VK_IMAGE_VIEW_TYPE_2D,
        .format = format,
        .subresourceRange = {aspect, 0, 1, 0, 1}};
    vk(vkCreateImageView(host->device, &view, NULL, &picture.view), "vkCreateImageView");
    return picture;
}

static void destroy_picture(const Host *host, Picture picture) {
    vkDestroyImageView(host->device, picture.view, NULL);
    vkDestroyImage(host->device, picture.image, NULL);
    vkFreeMemory(host->device, picture.memory, NULL);
}

static VkShaderModule load_shader(const Host *host, const char *folder, const char *name) {
    char path[4096];
    static uint32_t words[16384];
    snprintf(path, sizeof path, "%s/%s.spv", folder, name);
    FILE *file = fopen(path, "rb");
    if (file == NULL) {
        fail(path, "cannot be opened");
    }
    size_t bytes = fread(words, 1, sizeof words, file);
    fclose(file);
    VkShaderModuleCreateInfo create = {
        .sType = VK_STRUCTURE_TYPE_SHADER_MODULE_CREATE_INFO, .codeSize = bytes, .pCode = words};
    VkShaderModule module;
    vk(vkCreateShaderModule(host->device, &create, NULL, &module), path);
    return module;
}

/* A pipeline that draws to the output with depth test. over: premultiplied colour is put over what is there, and the depth is
 * left as it is. */
static VkPipeline create_pipeline(const Host *host, const char *folder, const char *vertex_name,
    const char *fragment_name, VkPipelineLayout layout, VkBool32 over) {
    VkShaderModule vertex = load_shader(host, folder, vertex_name);
    VkShaderModule fragment = load_shader(host, folder, fragment_name);
    VkPipelineShaderStageCreateInfo stages[] = {
        {.sType = VK_STRUCTURE_TYPE_PIPELINE_SHADER_STAGE_CREATE_INFO,
            .stage = VK_SHADER_STAGE_VERTEX_BIT,
            .module = vertex,
            .pName = "main"},
        {.sType = VK_STRUCTURE_TYPE_PIPELINE_SHADER_STAGE_CREATE_INFO,
            .stage = VK_SHADER_STAGE_FRAGMENT_BIT,
            .module = fragment,
            .pName = "main"},
    };
    VkPipelineVertexInputStateCreateInfo vertices = {
        .sType = VK_STRUCTURE_TYPE_PIPELINE_VERTEX_INPUT_STATE_CREATE_INFO};
    VkPipelineInputAssemblyStateCreateInfo assembly = {
        .sType = VK_STRUCTURE_TYPE_PIPELINE_INPUT_ASSEMBLY_STATE_CREATE_INFO,
        .topology = VK_PRIMITIVE_TOPOLOGY_TRIANGLE_LIST};
    VkPipelineViewportStateCreateInfo viewport = {
        .sType = VK_STRUCTURE_TYPE_PIPELINE_VIEWPORT_STATE_CREATE_INFO, .viewportCount = 1, .scissorCount = 1};
    VkPipelineRasterizationStateCreateInfo raster = {
        .sType = VK_STRUCTURE_TYPE_PIPELINE_RASTERIZATION_STATE_CREATE_INFO, .lineWidth = 1.0f};
    VkPipelineMultisampleStateCreateInfo samples = {.sType = VK_STRUCTURE_TYPE_PIPELINE_MULTISAMPLE_STATE_CREATE_INFO,
        .rasterizationSamples = VK_SAMPLE_COUNT_1_BIT};
    VkPipelineDepthStencilStateCreateInfo depth = {
        .sType = VK_STRUCTURE_TYPE_PIPELINE_DEPTH_STENCIL_STATE_CREATE_INFO,
        .depthTestEnable = VK_TRUE,
        .depthWriteEnable = !over,
        .depthCompareOp = VK_COMPARE_OP_LESS};
    VkPipelineColorBlendAttachmentState attachment = {.blendEnable = over,
        .srcColorBlendFactor = VK_BLEND_FACTOR_ONE,
        .dstColorBlendFactor = VK_BLEND_FACTOR_ONE_MINUS_SRC_ALPHA,
        .srcAlphaBlendFactor = VK_BLEND_FACTOR_ONE,
        .dstAlphaBlendFactor = VK_BLEND_FACTOR_ONE_MINUS_SRC_ALPHA,
        .colorWriteMask = 15};
    VkPipelineColorBlendStateCreateInfo blend = {.sType = VK_STRUCTURE_TYPE_PIPELINE_COLOR_BLEND_STATE_CREATE_INFO,
        .attachmentCount = 1,
        .pAttachments = &attachment};
    VkDynamicState states[] = {VK_DYNAMIC_STATE_VIEWPORT, VK_DYNAMIC_STATE_SCISSOR};
    VkPipelineDynamicStateCreateInfo dynamic = {.sType = VK_STRUCTURE_TYPE_PIPELINE_DYNAMIC_STATE_CREATE_INFO,
        .dynamicStateCount = LENGTH(states),
        .pDynamicStates = states};
    VkFormat format = VK_FORMAT_R8G8B8A8_UNORM;
    VkPipelineRenderingCreateInfo rendering = {.sType = VK_STRUCTURE_TYPE_PIPELINE_RENDERING_CREATE_INFO,
        .colorAttachmentCount = 1,
        .pColorAttachmentFormats = &format,
        .depthAttachmentFormat = VK_FORMAT_D32_SFLOAT};
    VkGraphicsPipelineCreateInfo create = {.sType = VK_STRUCTURE_TYPE_GRAPHICS_PIPELINE_CREATE_INFO,
        .pNext = &rendering,
        .stageCount = LENGTH(stages),
        .pStages = stages,
        .pVertexInputState = &vertices,
        .pInputAssemblyState = &assembly,
        .pViewportState = &viewport,
        .pRasterizationState = &raster,
        .pMultisampleState = &samples,
        .pDepthStencilState = &depth,
        .pColorBlendState = &blend,
        .pDynamicState = &dynamic,
        .layout = layout};
    VkPipeline pipeline;
    vk(vkCreateGraphicsPipelines(host->device, VK_NULL_HANDLE, 1, &create, NULL, &pipeline), "vkCreateGraphicsPipelines");
    vkDestroyShaderModule(host->device, vertex, NULL);
    vkDestroyShaderModule(host->device, fragment, NULL);
    return pipeline;
}

static void image_barrier(VkCommandBuffer commands, VkImage image, VkImageAspectFlags aspect, VkImageLayout from,
    VkImageLayout to, VkPipelineStageFlags2 from_stages, VkAccessFlags2 from_access, VkPipelineStageFlags2 to_stages,
    VkAccessFlags2 to_access) {
    VkImageMemoryBarrier2 barrier = {.sType = VK_STRUCTURE_TYPE_IMAGE_MEMORY_BARRIER_2,
        .srcStageMask = from_stages,
        .srcAccessMask = from_access,
        .dstStageMask = to_stages,
        .dstAccessMask = to_access,
        .oldLayout = from,
        .newLayout = to,
        .srcQueueFamilyIndex = VK_QUEUE_FAMILY_IGNORED,
        .dstQueueFamilyIndex = VK_QUEUE_FAMILY_IGNORED,
        .image = image,
        .subresourceRange = {aspect, 0, 1, 0, 1}};
    VkDependencyInfo dependency = {
        .sType = VK_STRUCTURE_TYPE_DEPENDENCY_INFO, .imageMemoryBarrierCount = 1, .pImageMemoryBarriers = &barrier};
    vkCmdPipelineBarrier2(commands, &dependency);
}

/* ---- Camera and mesh ------------------------------------------------------------------------------------------------- */

/* Column-major 4x4 matrices; out = a * b. */
static void multiply(double out[16], const double a[16], const double b[16]) {
    double product[16] = {0};
    for (int i = 0; i < 64; i++) {
        int column = i / 16, row = i / 4 % 4, k = i % 4;
        product[4 * column + row] += a[4 * k + row] * b[4 * column + k];
    }
    memcpy(out, product, sizeof product);
}

static void normalise(double v[3]) {
    double length = sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);
    for (int i = 0; i < 3; i++) {
        v[i] /= length;
    }
}

static void cross(double out[3], const double a[3], const double b[3]) {
    for (int i = 0; i < 3; i++) {
        out[i] = a[(i + 1) % 3] * b[(i + 2) % 3] - a[(i + 2) % 3] * b[(i + 1) % 3];
    }
}

/* Looks from eye at target with z up in the world. */
static spgs_camera look_at(const double eye[3], const double target[3], double fov_x, uint32_t width, uint32_t height) {
    double up[3] = {0.0, 0.0, 1.0}, x[3], y[3], z[3];
    for (int i = 0; i < 3; i++) {
        z[i] = target[i] - eye[i];
    }
    normalise(z);
    cross(x, z, up);
    normalise(x);
    cross(y, z, x);
    double focal = 0.5 * width / tan(0.5 * fov_x);
    spgs_camera camera = {
        .width = width, .height = height, .fx = focal, .fy = focal, .cx = 0.5 * width, .cy = 0.5 * height};
    for (int i = 0; i < 3; i++) {
        camera.world_to_camera[4 * i] = x[i];
        camera.world_to_camera[4 * i + 1] = y[i];
        camera.world_to_camera[4 * i + 2] = z[i];
        camera.world_to_camera[12] -= x[i] * eye[i];
        camera.world_to_camera[13] -= y[i] * eye[i];
        camera.world_to_camera[14] -= z[i] * eye[i];
    }
    camera.world_to_camera[15] = 1.0;
    return camera;
}

/* A cube of half edge size at centre, turned by angle about axis. */
static void cube(double out[16], const double centre[3], double size, const double axis_in[3], double angle) {
    double a[3] = {axis_in[0], axis_in[1], axis_in[2]};
    normalise(a);
    double c = cos(angle), s = sin(angle);
    double m[16] = {
        c + a[0] * a[0] * (1 - c), a[0] * a[1] * (1 - c) + a[2] * s, a[0] * a[2] * (1 - c) - a[1] * s, 0,
        a[0] * a[1] * (1 - c) - a[2] * s, c + a[1] * a[1] * (1 - c), a[1] * a[2] * (1 - c) + a[0] * s, 0,
        a[0] * a[2] * (1 - c) + a[1] * s, a[1] * a[2] * (1 - c) - a[0] * s, c + a[2] * a[2] * (1 - c), 0,
        centre[0], centre[1], centre[2], 1};
    for (int i = 0; i < 12; i++) {
        m[i] *= size;
    }
    memcpy(out, m, sizeof m);
}

/* ---- The engine inside the host -------------------------------------------------------------------------------------- */

int main(int argc, char **argv) {
    if (argc != 3 && argc != 5) {
        fprintf(stderr, "usage: %s SHADER_DIR OUT.ppm [WIDTH HEIGHT]\n", argv[0]);
        return 2;
    }
    const char *shaders = argv[1];
    uint32_t width = argc == 5 ? (uint32_t)atoi(argv[3]) : 640, height = argc == 5 ? (uint32_t)atoi(argv[4]) : 480;
    const double time = 0.25;
    Host host = {0};
    create_instance(&host, getenv("SPGS_VALIDATION") != NULL);
    create_device(&host);

    /* The engine on this device, a scene, a view with colour and depth. Uploads happen in this thread, so the queue needs no
     * lock. */
    spgs_host on = {.struct_size = sizeof on,
        .api_version = VK_API_VERSION_1_3,
        .get_instance_proc_addr = (void (*)(void))vkGetInstanceProcAddr,
        .instance = host.instance,
        .physical_device = host.physical,
        .device = host.device,
        .queue = host.queue,
        .queue_family = host.family};
    spgs_gpu *gpu;
    spgs(spgs_gpu_from_host(&on, &gpu), "device");
    spgs_scene *scene;
    spgs(spgs_scene_demo(gpu, NULL, &scene), "scene");
    spgs_view_options options = {
        .struct_size = sizeof options, .format = SPGS_RGBA16F, .depth = 1, .in_flight = 1, .near_plane = 0.2f};
    spgs_view *view;
    spgs(spgs_view_create(gpu, scene, &options, &view), "view");
    double angle = -1.1 + 0.3, aspect = (double)width / height;
    double eye[3] = {7.2 * cos(angle), 7.2 * sin(angle), 3.4}, target_point[3] = {0.0, 0.0, 1.0};
    spgs_camera camera = look_at(eye, target_point, 0.75 * 0.8 * (aspect > 1.0 ? aspect : 1.0), width, height);
    spgs(spgs_view_warm_up(view, &camera, time, NULL), "warming up");

    /* Images and pipelines of the host's own drawing. */
    VkExtent3D size = {width, height, 1};
    VkImageUsageFlags written = VK_IMAGE_USAGE_TRANSFER_DST_BIT | VK_IMAGE_USAGE_SAMPLED_BIT;
    Picture scene_color = create_picture(&host, size, VK_FORMAT_R16G16B16A16_SFLOAT, written);
    Picture scene_depth = create_picture(&host, size, VK_FORMAT_R32_SFLOAT, written);
    Picture output = create_picture(&host, size, VK_FORMAT_R8G8B8A8_UNORM,
        VK_IMAGE_USAGE_COLOR_ATTACHMENT_BIT | VK_IMAGE_USAGE_TRANSFER_SRC_BIT);
    Picture depth = create_picture(&host, size, VK_FORMAT_D32_SFLOAT, VK_IMAGE_USAGE_DEPTH_STENCIL_ATTACHMENT_BIT);
    VkSampler sampler;
    VkSamplerCreateInfo sampler_create = {.sType = VK_STRUCTURE_TYPE_SAMPLER_CREATE_INFO};
    vk(vkCreateSampler(host.device, &sampler_create, NULL, &sampler), "vkCreateSampler");
    VkDescriptorSetLayoutBinding bindings[2];
    for (uint32_t i = 0; i < 2; i++) {
        bindings[i] = (VkDescriptorSetLayoutBinding){
            i, VK_DESCRIPTOR_TYPE_COMBINED_IMAGE_SAMPLER, 1, VK_SHADER_STAGE_FRAGMENT_BIT, NULL};
    }
    VkDescriptorSetLayoutCreateInfo set_create = {
        .sType = VK_STRUCTURE_TYPE_DESCRIPTOR_SET_LAYOUT_CREATE_INFO, .bindingCount = 2, .pBindings = bindings};
    VkDescriptorSetLayout set_layout;
    vk(vkCreateDescriptorSetLayout(host.device, &set_create, NULL, &set_layout), "vkCreateDescriptorSetLayout");
    VkShaderStageFlags stages = VK_SHADER_STAGE_VERTEX_BIT | VK_SHADER_STAGE_FRAGMENT_BIT;
    VkPushConstantRange range = {stages, 0, 64};
    VkPipelineLayoutCreateInfo layout_create = {.sType = VK_STRUCTURE_TYPE_PIPELINE_LAYOUT_CREATE_INFO,
        .setLayoutCount = 1,
        .pSetLayouts = &set_layout,
        .pushConstantRangeCount = 1,
        .pPushConstantRanges = &range};
    VkPipelineLayout layout;
    vk(vkCreatePipelineLayout(host.device, &layout_create, NULL, &layout), "vkCreatePipelineLayout");
    VkPipeline mesh = create_pipeline(&host, shaders, "mesh.vert", "mesh.frag", layout, VK_FALSE);
    VkPipeline composite = create_pipeline(&host, shaders, "composite.vert", "composite.frag", layout, VK_TRUE);
    VkDescriptorPoolSize pool_size = {VK_DESCRIPTOR_TYPE_COMBINED_IMAGE_SAMPLER, 2};
    VkDescriptorPoolCreateInfo pool_create = {.sType = VK_STRUCTURE_TYPE_DESCRIPTOR_POOL_CREATE_INFO,
        .maxSets = 1,
        .poolSizeCount = 1,
        .pPoolSizes = &pool_size};
    VkDescriptorPool descriptors;
    vk(vkCreateDescriptorPool(host.device, &pool_create, NULL, &descriptors), "vkCreateDescriptorPool");
    VkDescriptorSetAllocateInfo set_allocate = {.sType = VK_STRUCTURE_TYPE_DESCRIPTOR_SET_ALLOCATE_INFO,
        .descriptorPool = descriptors,
        .descriptorSetCount = 1,
        .pSetLayouts = &set_layout};
    VkDescriptorSet set;
    vk(vkAllocateDescriptorSets(host.device, &set_allocate, &set), "vkAllocateDescriptorSets");
    VkDescriptorImageInfo pictures[] = {{sampler, scene_color.view, VK_IMAGE_LAYOUT_SHADER_READ_ONLY_OPTIMAL},
        {sampler, scene_depth.view, VK_IMAGE_LAYOUT_SHADER_READ_ONLY_OPTIMAL}};
    VkWriteDescriptorSet write = {.sType = VK_STRUCTURE_TYPE_WRITE_DESCRIPTOR_SET,
        .dstSet = set,
        .descriptorCount = 2,
        .descriptorType = VK_DESCRIPTOR_TYPE_COMBINED_IMAGE_SAMPLER,
        .pImageInfo = pictures};
    vkUpdateDescriptorSets(host.device, 1, &write, 0, NULL);
    VkBuffer buffer;
    VkBufferCreateInfo buffer_create = {.sType = VK_STRUCTURE_TYPE_BUFFER_CREATE_INFO,
        .size = 4ull * width * height,
        .usage = VK_BUFFER_USAGE_TRANSFER_DST_BIT};
    vk(vkCreateBuffer(host.device, &buffer_create, NULL, &buffer), "vkCreateBuffer");
    VkMemoryRequirements needs;
    vkGetBufferMemoryRequirements(host.device, buffer, &needs);
    VkDeviceMemory buffer_memory =
        allocate(&host, needs, VK_MEMORY_PROPERTY_HOST_VISIBLE_BIT | VK_MEMORY_PROPERTY_HOST_COHERENT_BIT);
    vk(vkBindBufferMemory(host.device, buffer, buffer_memory, 0), "vkBindBufferMemory");

    /* A frame: the scene into its images ... */
    VkCommandBufferBeginInfo begin = {.sType = VK_STRUCTURE_TYPE_COMMAND_BUFFER_BEGIN_INFO,
        .flags = VK_COMMAND_BUFFER_USAGE_ONE_TIME_SUBMIT_BIT};
    vk(vkBeginCommandBuffer(host.commands, &begin), "vkBeginCommandBuffer");
    spgs_image to_sample = {.old_layout = VK_IMAGE_LAYOUT_UNDEFINED,
        .new_layout = VK_IMAGE_LAYOUT_SHADER_READ_ONLY_OPTIMAL,
        .before_stages = VK_PIPELINE_STAGE_2_FRAGMENT_SHADER_BIT,
        .after_stages = VK_PIPELINE_STAGE_2_FRAGMENT_SHADER_BIT,
        .after_access = VK_ACCESS_2_SHADER_READ_BIT};
    spgs_image depth_target = to_sample;
    depth_target.image = (uint64_t)scene_depth.image;
    spgs_target target = {.color = to_sample, .depth = &depth_target};
    target.color.image = (uint64_t)scene_color.image;
    spgs(spgs_view_record(view, host.commands, &camera, time, &target, NULL), "frame");

    /* ... the mesh, and the scene among it by depth A + B / z. */
    VkPipelineStageFlags2 tests =
        VK_PIPELINE_STAGE_2_EARLY_FRAGMENT_TESTS_BIT | VK_PIPELINE_STAGE_2_LATE_FRAGMENT_TESTS_BIT;
    image_barrier(host.commands, output.image, VK_IMAGE_ASPECT_COLOR_BIT, VK_IMAGE_LAYOUT_UNDEFINED,
        VK_IMAGE_LAYOUT_COLOR_ATTACHMENT_OPTIMAL, VK_PIPELINE_STAGE_2_NONE, 0,
        VK_PIPELINE_STAGE_2_COLOR_ATTACHMENT_OUTPUT_BIT,
        VK_ACCESS_2_COLOR_ATTACHMENT_WRITE_BIT | VK_ACCESS_2_COLOR_ATTACHMENT_READ_BIT);
    image_barrier(host.commands, depth.image, VK_IMAGE_ASPECT_DEPTH_BIT, VK_IMAGE_LAYOUT_UNDEFINED,
        VK_IMAGE_LAYOUT_DEPTH_ATTACHMENT_OPTIMAL, VK_PIPELINE_STAGE_2_NONE, 0, tests,
        VK_ACCESS_2_DEPTH_STENCIL_ATTACHMENT_READ_BIT | VK_ACCESS_2_DEPTH_STENCIL_ATTACHMENT_WRITE_BIT);
    VkRenderingAttachmentInfo color_attachment = {.sType = VK_STRUCTURE_TYPE_RENDERING_ATTACHMENT_INFO,
        .imageView = output.view,
        .imageLayout = VK_IMAGE_LAYOUT_COLOR_ATTACHMENT_OPTIMAL,
        .loadOp = VK_ATTACHMENT_LOAD_OP_CLEAR,
        .storeOp = VK_ATTACHMENT_STORE_OP_STORE,
        .clearValue = {.color = {{0.02f, 0.02f, 0.04f, 1.0f}}}};
    VkRenderingAttachmentInfo depth_attachment = {.sType = VK_STRUCTURE_TYPE_RENDERING_ATTACHMENT_INFO,
        .imageView = depth.view,
        .imageLayout = VK_IMAGE_LAYOUT_DEPTH_ATTACHMENT_OPTIMAL,
        .loadOp = VK_ATTACHMENT_LOAD_OP_CLEAR,
        .storeOp = VK_ATTACHMENT_STORE_OP_DONT_CARE,
        .clearValue = {.depthStencil = {1.0f, 0}}};
    VkRect2D area = {{0, 0}, {width, height}};
    VkRenderingInfo rendering = {.sType = VK_STRUCTURE_TYPE_RENDERING_INFO,
        .renderArea = area,
        .layerCount = 1,
        .colorAttachmentCount = 1,
        .pColorAttachments = &color_attachment,
        .pDepthAttachment = &depth_attachment};
    vkCmdBeginRendering(host.commands, &rendering);
    VkViewport viewport = {0.0f, 0.0f, (float)width, (float)height, 0.0f, 1.0f};
    vkCmdSetViewport(host.commands, 0, 1, &viewport);
    vkCmdSetScissor(host.commands, 0, 1, &area);
    double scale = FAR_PLANE / (FAR_PLANE - NEAR_PLANE), offset = -NEAR_PLANE * scale;
    double clip_from_camera[16] = {2.0 * camera.fx / width, 0, 0, 0, 0, 2.0 * camera.fy / height, 0, 0,
        2.0 * camera.cx / width - 1.0, 2.0 * camera.cy / height - 1.0, scale, 1, 0, 0, offset, 0};
    double clip[16], centre[3] = {0.0, 0.0, 0.6}, axis[3] = {0.3, 1.0, 0.2};
    cube(clip, centre, 0.5, axis, 0.6);
    multiply(clip, camera.world_to_camera, clip);
    multiply(clip, clip_from_camera, clip);
    float mesh_push[16];
    for (int i = 0; i < 16; i++) {
        mesh_push[i] = (float)clip[i];
    }
    vkCmdBindPipeline(host.commands, VK_PIPELINE_BIND_POINT_GRAPHICS, mesh);
    vkCmdPushConstants(host.commands, layout, stages, 0, sizeof mesh_push, mesh_push);
    vkCmdDraw(host.commands, 36, 1, 0, 0);
    float composite_push[2] = {(float)scale, (float)offset};
    vkCmdBindPipeline(host.commands, VK_PIPELINE_BIND_POINT_GRAPHICS, composite);
    vkCmdBindDescriptorSets(host.commands, VK_PIPELINE_BIND_POINT_GRAPHICS, layout, 0, 1, &set, 0, NULL);
    vkCmdPushConstants(host.commands, layout, stages, 0, sizeof composite_push, composite_push);
    vkCmdDraw(host.commands, 3, 1, 0, 0);
    vkCmdEndRendering(host.commands);

    /* Out to the host's memory. */
    image_barrier(host.commands, output.image, VK_IMAGE_ASPECT_COLOR_BIT, VK_IMAGE_LAYOUT_COLOR_ATTACHMENT_OPTIMAL,
        VK_IMAGE_LAYOUT_TRANSFER_SRC_OPTIMAL, VK_PIPELINE_STAGE_2_COLOR_ATTACHMENT_OUTPUT_BIT,
        VK_ACCESS_2_COLOR_ATTACHMENT_WRITE_BIT, VK_PIPELINE_STAGE_2_TRANSFER_BIT, VK_ACCESS_2_TRANSFER_READ_BIT);
    VkBufferImageCopy region = {.imageSubresource = {VK_IMAGE_ASPECT_COLOR_BIT, 0, 0, 1}, .imageExtent = size};
    vkCmdCopyImageToBuffer(
        host.commands, output.image, VK_IMAGE_LAYOUT_TRANSFER_SRC_OPTIMAL, buffer, 1, &region);
    VkMemoryBarrier2 visible = {.sType = VK_STRUCTURE_TYPE_MEMORY_BARRIER_2,
        .srcStageMask = VK_PIPELINE_STAGE_2_TRANSFER_BIT,
        .srcAccessMask = VK_ACCESS_2_TRANSFER_WRITE_BIT,
        .dstStageMask = VK_PIPELINE_STAGE_2_HOST_BIT,
        .dstAccessMask = VK_ACCESS_2_HOST_READ_BIT};
    VkDependencyInfo dependency = {
        .sType = VK_STRUCTURE_TYPE_DEPENDENCY_INFO, .memoryBarrierCount = 1, .pMemoryBarriers = &visible};
    vkCmdPipelineBarrier2(host.commands, &dependency);
    vk(vkEndCommandBuffer(host.commands), "vkEndCommandBuffer");
    VkSubmitInfo submit = {
        .sType = VK_STRUCTURE_TYPE_SUBMIT_INFO, .commandBufferCount = 1, .pCommandBuffers = &host.commands};
    vk(vkQueueSubmit(host.queue, 1, &submit, VK_NULL_HANDLE), "vkQueueSubmit");
    vk(vkQueueWaitIdle(host.queue), "vkQueueWaitIdle");

    spgs_finished finished;
    spgs(spgs_view_all_finished(view, &finished), "the frame's counters");
    if (finished.serial == 0 || finished.overflowed || finished.statistics.visible == 0) {
        fail("the frame's counters", "nothing was drawn");
    }
    void *mapped;
    vk(vkMapMemory(host.device, buffer_memory, 0, VK_WHOLE_SIZE, 0, &mapped), "vkMapMemory");
    FILE *file = fopen(argv[2], "wb");
    if (file == NULL) {
        fail(argv[2], "cannot be written");
    }
    fprintf(file, "P6\n%u %u\n255\n", width, height);
    for (uint32_t i = 0; i < width * height; i++) {
        fwrite((const char *)mapped + 4 * i, 1, 3, file);
    }
    if (fclose(file) != 0) {
        fail(argv[2], "cannot be written");
    }
    printf("%u Gaussians visible, %llu tile instances\n", finished.statistics.visible,
        (unsigned long long)finished.statistics.instances);

    /* The device is idle: everything goes, the engine's objects before the device. */
    spgs_view_destroy(view);
    spgs_scene_destroy(scene);
    spgs_gpu_destroy(gpu);
    vkDestroyBuffer(host.device, buffer, NULL);
    vkFreeMemory(host.device, buffer_memory, NULL);
    vkDestroyDescriptorPool(host.device, descriptors, NULL);
    vkDestroyPipeline(host.device, mesh, NULL);
    vkDestroyPipeline(host.device, composite, NULL);
    vkDestroyPipelineLayout(host.device, layout, NULL);
    vkDestroyDescriptorSetLayout(host.device, set_layout, NULL);
    vkDestroySampler(host.device, sampler, NULL);
    Picture all[] = {scene_color, scene_depth, output, depth};
    for (uint32_t i = 0; i < LENGTH(all); i++) {
        destroy_picture(&host, all[i]);
    }
    vkDestroyCommandPool(host.device, host.pool, NULL);
    vkDestroyDevice(host.device, NULL);
    if (host.messenger != VK_NULL_HANDLE) {
        PFN_vkDestroyDebugUtilsMessengerEXT destroy = (PFN_vkDestroyDebugUtilsMessengerEXT)vkGetInstanceProcAddr(
            host.instance, "vkDestroyDebugUtilsMessengerEXT");
        destroy(host.instance, host.messenger, NULL);
    }
    vkDestroyInstance(host.instance, NULL);
    return messages == 0 ? 0 : 1;
}
