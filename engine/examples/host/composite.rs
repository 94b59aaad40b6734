//! The host's own drawing: a mesh, and the engine's picture among it by depth.

use std::sync::Arc;

use ash::vk;
use engine::gpu::{Gpu, GpuOptions, HostCommandBuffer, HostDevice, HostImage, ImageUse, QueueLock};
use engine::render::{PixelFormat, SceneHandle, SceneOptions, Target, View, ViewOptions};
use engine::scene::{Camera, Scene};
use glam::{DMat4, DVec3, DVec4};
use vk::Handle as _;

use crate::vulkan::{Frame, Picture, Result, Turn, Vulkan, layers};

const NEAR: f64 = 0.1;
const FAR: f64 = 100.0;
/// Format of the finished picture.
const FORMAT: vk::Format = vk::Format::R8G8B8A8_UNORM;

impl QueueLock for Turn {
    fn lock(&self) {
        self.take();
    }
    fn unlock(&self) {
        self.give_back();
    }
}

/// The engine on the host's device.
pub(crate) fn engine_on(host: &Vulkan) -> engine::Result<Gpu> {
    let device = HostDevice {
        get_instance_proc_addr: None,
        api_version: vk::API_VERSION_1_3,
        instance: host.instance.handle().as_raw(),
        physical_device: host.physical.as_raw(),
        device: host.device.handle().as_raw(),
        queue: host.queue.as_raw(),
        queue_family: host.family,
        queue_lock: Some(Arc::clone(&host.turn) as Arc<dyn QueueLock>),
    };
    // SAFETY: the handles are this program's own and live until the end of `main`.
    unsafe { Gpu::from_host(&device, &GpuOptions { pipeline_cache: false, ..GpuOptions::default() }) }
}

/// A pipeline with what it is made of.
struct Pipeline {
    raw: vk::Pipeline,
    layout: vk::PipelineLayout,
    set_layout: vk::DescriptorSetLayout,
}

/// Everything for one picture after another.
pub(crate) struct Compositor {
    host: Arc<Vulkan>,
    view: View,
    scene_color: Picture,
    scene_depth: Picture,
    output: Picture,
    depth: Picture,
    frame: Frame,
    sampler: vk::Sampler,
    descriptors: vk::DescriptorPool,
    set: vk::DescriptorSet,
    mesh: Pipeline,
    composite: Pipeline,
}

impl Compositor {
    pub(crate) fn new(host: &Arc<Vulkan>, gpu: &Gpu, scene: &Scene, size: [u32; 2]) -> Result<Self> {
        let scene = SceneHandle::upload(gpu, scene, &SceneOptions::default())?;
        // One frame in flight: `begin` waits for the one before.
        let options = ViewOptions { format: PixelFormat::Rgba16F, depth: true, in_flight: 1, ..ViewOptions::default() };
        let view = View::new(gpu, &scene, &options)?;
        let written = vk::ImageUsageFlags::TRANSFER_DST | vk::ImageUsageFlags::SAMPLED;
        let drawn = vk::ImageUsageFlags::COLOR_ATTACHMENT | vk::ImageUsageFlags::TRANSFER_SRC;
        let scene_color = host.picture(size, vk::Format::R16G16B16A16_SFLOAT, written)?;
        let scene_depth = host.picture(size, vk::Format::R32_SFLOAT, written)?;
        let output = host.picture(size, FORMAT, drawn)?;
        let depth = host.picture(size, vk::Format::D32_SFLOAT, vk::ImageUsageFlags::DEPTH_STENCIL_ATTACHMENT)?;
        let sampler = unsafe { host.device.create_sampler(&vk::SamplerCreateInfo::default(), None)? };
        let mesh = pipeline(
            host,
            [include_bytes!("../shaders/mesh.vert.spv"), include_bytes!("../shaders/mesh.frag.spv")],
            0,
            false,
        )?;
        let composite = pipeline(
            host,
            [include_bytes!("../shaders/composite.vert.spv"), include_bytes!("../shaders/composite.frag.spv")],
            2,
            true,
        )?;
        let (descriptors, set) = pictures_set(host, &composite, sampler, [scene_color, scene_depth])?;
        let (host, frame) = (Arc::clone(host), host.frame()?);
        Ok(Self {
            host,
            view,
            scene_color,
            scene_depth,
            output,
            depth,
            frame,
            sampler,
            descriptors,
            set,
            mesh,
            composite,
        })
    }

    /// Finds out how large the view's buffers must be, so that no frame is lost to their growth.
    pub(crate) fn warm_up(&mut self, camera: &Camera, time: f64) -> Result<()> {
        self.view.warm_up(camera, time)?;
        Ok(())
    }

    /// One frame: the scene into its images, the mesh, the scene among it. Returns RGBA8, row by row.
    pub(crate) fn draw(&mut self, camera: &Camera, time: f64, world_from_mesh: DMat4) -> Result<Vec<u8>> {
        self.host.begin(self.frame)?;
        let commands = self.frame.commands;
        let image = |picture: Picture| unsafe {
            let raw = picture.image.as_raw();
            HostImage::from_raw(raw, ImageUse::DISCARD_AFTER_SAMPLING, ImageUse::FRAGMENT_SAMPLED)
        };
        let target = Target { color: image(self.scene_color), depth: Some(image(self.scene_depth)) };
        let host_commands = unsafe { HostCommandBuffer::from_raw(commands.as_raw()) };
        self.view.record(&host_commands, camera, time, &target)?;
        self.draw_mesh_and_scene(commands, camera, world_from_mesh);
        self.host.submit(self.frame)?;
        self.host.wait(self.frame)?;
        self.host.read(self.output, 4)
    }

    fn draw_mesh_and_scene(&self, commands: vk::CommandBuffer, camera: &Camera, world_from_mesh: DMat4) {
        let device = &self.host.device;
        let [width, height] = self.output.size;
        let area = vk::Rect2D::default().extent(vk::Extent2D { width, height });
        let clear_color = vk::ClearColorValue { float32: [0.02, 0.02, 0.04, 1.0] };
        let color = [vk::RenderingAttachmentInfo::default()
            .image_view(self.output.view)
            .image_layout(vk::ImageLayout::COLOR_ATTACHMENT_OPTIMAL)
            .load_op(vk::AttachmentLoadOp::CLEAR)
            .store_op(vk::AttachmentStoreOp::STORE)
            .clear_value(vk::ClearValue { color: clear_color })];
        let clear_depth = vk::ClearDepthStencilValue { depth: 1.0, stencil: 0 };
        let depth = vk::RenderingAttachmentInfo::default()
            .image_view(self.depth.view)
            .image_layout(vk::ImageLayout::DEPTH_ATTACHMENT_OPTIMAL)
            .load_op(vk::AttachmentLoadOp::CLEAR)
            .store_op(vk::AttachmentStoreOp::DONT_CARE)
            .clear_value(vk::ClearValue { depth_stencil: clear_depth });
        let rendering = vk::RenderingInfo::default()
            .render_area(area)
            .layer_count(1)
            .color_attachments(&color)
            .depth_attachment(&depth);
        let viewport =
            vk::Viewport { x: 0.0, y: 0.0, width: width as f32, height: height as f32, min_depth: 0.0, max_depth: 1.0 };
        let clip_from_mesh = clip_from_camera(camera) * camera.world_to_camera() * world_from_mesh;
        let mesh_push = clip_from_mesh.as_mat4().to_cols_array();
        let [scale, offset] = depth_terms();
        let composite_push = [scale as f32, offset as f32];
        unsafe {
            self.attachments(commands, true);
            device.cmd_begin_rendering(commands, &rendering);
            device.cmd_set_viewport(commands, 0, &[viewport]);
            device.cmd_set_scissor(commands, 0, &[area]);
            let point = vk::PipelineBindPoint::GRAPHICS;
            let stages = vk::ShaderStageFlags::VERTEX | vk::ShaderStageFlags::FRAGMENT;
            device.cmd_bind_pipeline(commands, point, self.mesh.raw);
            device.cmd_push_constants(commands, self.mesh.layout, stages, 0, bytemuck::cast_slice(&mesh_push));
            device.cmd_draw(commands, 36, 1, 0, 0);
            device.cmd_bind_pipeline(commands, point, self.composite.raw);
            device.cmd_bind_descriptor_sets(commands, point, self.composite.layout, 0, &[self.set], &[]);
            device.cmd_push_constants(
                commands,
                self.composite.layout,
                stages,
                0,
                bytemuck::cast_slice(&composite_push),
            );
            device.cmd_draw(commands, 3, 1, 0, 0);
            device.cmd_end_rendering(commands);
            self.attachments(commands, false);
        }
    }

    /// Layouts of the host's attachments before drawing, and of the output for reading it.
    unsafe fn attachments(&self, commands: vk::CommandBuffer, before: bool) {
        let color = vk::ImageMemoryBarrier2::default().image(self.output.image).subresource_range(layers(false));
        let written = (vk::PipelineStageFlags2::COLOR_ATTACHMENT_OUTPUT, vk::AccessFlags2::COLOR_ATTACHMENT_WRITE);
        let tests = vk::PipelineStageFlags2::EARLY_FRAGMENT_TESTS | vk::PipelineStageFlags2::LATE_FRAGMENT_TESTS;
        let depth_access =
            vk::AccessFlags2::DEPTH_STENCIL_ATTACHMENT_READ | vk::AccessFlags2::DEPTH_STENCIL_ATTACHMENT_WRITE;
        let barriers = if before {
            vec![
                color
                    .old_layout(vk::ImageLayout::UNDEFINED)
                    .new_layout(vk::ImageLayout::COLOR_ATTACHMENT_OPTIMAL)
                    .src_stage_mask(vk::PipelineStageFlags2::TRANSFER)
                    .dst_stage_mask(written.0)
                    .dst_access_mask(written.1 | vk::AccessFlags2::COLOR_ATTACHMENT_READ),
                vk::ImageMemoryBarrier2::default()
                    .image(self.depth.image)
                    .subresource_range(layers(true))
                    .old_layout(vk::ImageLayout::UNDEFINED)
                    .new_layout(vk::ImageLayout::DEPTH_ATTACHMENT_OPTIMAL)
                    .src_stage_mask(tests)
                    .src_access_mask(vk::AccessFlags2::DEPTH_STENCIL_ATTACHMENT_WRITE)
                    .dst_stage_mask(tests)
                    .dst_access_mask(depth_access),
            ]
        } else {
            vec![
                color
                    .old_layout(vk::ImageLayout::COLOR_ATTACHMENT_OPTIMAL)
                    .new_layout(vk::ImageLayout::TRANSFER_SRC_OPTIMAL)
                    .src_stage_mask(written.0)
                    .src_access_mask(written.1)
                    .dst_stage_mask(vk::PipelineStageFlags2::TRANSFER)
                    .dst_access_mask(vk::AccessFlags2::TRANSFER_READ),
            ]
        };
        let dependency = vk::DependencyInfo::default().image_memory_barriers(&barriers);
        unsafe { self.host.device.cmd_pipeline_barrier2(commands, &dependency) };
    }
}

impl Drop for Compositor {
    fn drop(&mut self) {
        // Nothing is in flight: `draw` waits.
        unsafe {
            let device = &self.host.device;
            for p in [&self.mesh, &self.composite] {
                device.destroy_pipeline(p.raw, None);
                device.destroy_pipeline_layout(p.layout, None);
                device.destroy_descriptor_set_layout(p.set_layout, None);
            }
            device.destroy_descriptor_pool(self.descriptors, None);
            device.destroy_sampler(self.sampler, None);
        }
        self.host.destroy_frame(self.frame);
        [self.scene_color, self.scene_depth, self.output, self.depth].into_iter().for_each(|p| self.host.destroy(p));
    }
}

/// Depth of the mesh is A + B / z, z along the viewing direction.
fn depth_terms() -> [f64; 2] {
    [FAR / (FAR - NEAR), -NEAR * FAR / (FAR - NEAR)]
}

/// Vulkan's clip space (y down, depth 0 to 1) from the camera's axes (x right, y down, z forward).
fn clip_from_camera(camera: &Camera) -> DMat4 {
    let (w, h) = (f64::from(camera.width), f64::from(camera.height));
    let [scale, offset] = depth_terms();
    DMat4::from_cols(
        DVec4::new(2.0 * camera.fx / w, 0.0, 0.0, 0.0),
        DVec4::new(0.0, 2.0 * camera.fy / h, 0.0, 0.0),
        DVec4::new(2.0 * camera.cx / w - 1.0, 2.0 * camera.cy / h - 1.0, scale, 1.0),
        DVec4::new(0.0, 0.0, offset, 0.0),
    )
}

/// A cube of half edge `size` at `centre`, turned a little.
pub(crate) fn cube(centre: DVec3, size: f64) -> DMat4 {
    DMat4::from_translation(centre)
        * DMat4::from_axis_angle(DVec3::new(0.3, 1.0, 0.2).normalize(), 0.6)
        * DMat4::from_scale(DVec3::splat(size))
}

fn module(host: &Vulkan, spirv: &[u8]) -> Result<vk::ShaderModule> {
    let words: Vec<u32> = spirv.chunks_exact(4).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect();
    let create = vk::ShaderModuleCreateInfo::default().code(&words);
    Ok(unsafe { host.device.create_shader_module(&create, None)? })
}

/// A pipeline that draws to the output with depth test; `images` samplers in its fragment shader; `over`: premultiplied
/// colour is put over what is there and the depth is left as it is.
fn pipeline(host: &Vulkan, spirv: [&[u8]; 2], images: u32, over: bool) -> Result<Pipeline> {
    let bindings: Vec<_> = (0..images)
        .map(|binding| {
            vk::DescriptorSetLayoutBinding::default()
                .binding(binding)
                .descriptor_type(vk::DescriptorType::COMBINED_IMAGE_SAMPLER)
                .descriptor_count(1)
                .stage_flags(vk::ShaderStageFlags::FRAGMENT)
        })
        .collect();
    let create = vk::DescriptorSetLayoutCreateInfo::default().bindings(&bindings);
    let set_layout = unsafe { host.device.create_descriptor_set_layout(&create, None)? };
    let set_layouts = [set_layout];
    let stages = vk::ShaderStageFlags::VERTEX | vk::ShaderStageFlags::FRAGMENT;
    let ranges = [vk::PushConstantRange::default().stage_flags(stages).size(64)];
    let create = vk::PipelineLayoutCreateInfo::default().set_layouts(&set_layouts).push_constant_ranges(&ranges);
    let layout = unsafe { host.device.create_pipeline_layout(&create, None)? };
    let modules = [module(host, spirv[0])?, module(host, spirv[1])?];
    let stage = |stage, module| vk::PipelineShaderStageCreateInfo::default().stage(stage).module(module).name(c"main");
    let stages = [stage(vk::ShaderStageFlags::VERTEX, modules[0]), stage(vk::ShaderStageFlags::FRAGMENT, modules[1])];
    let vertices = vk::PipelineVertexInputStateCreateInfo::default();
    let assembly = vk::PipelineInputAssemblyStateCreateInfo::default().topology(vk::PrimitiveTopology::TRIANGLE_LIST);
    let viewport = vk::PipelineViewportStateCreateInfo::default().viewport_count(1).scissor_count(1);
    let raster = vk::PipelineRasterizationStateCreateInfo::default().line_width(1.0);
    let samples = vk::PipelineMultisampleStateCreateInfo::default().rasterization_samples(vk::SampleCountFlags::TYPE_1);
    let depth = vk::PipelineDepthStencilStateCreateInfo::default()
        .depth_test_enable(true)
        .depth_write_enable(!over)
        .depth_compare_op(vk::CompareOp::LESS);
    let blend = [vk::PipelineColorBlendAttachmentState::default()
        .blend_enable(over)
        .src_color_blend_factor(vk::BlendFactor::ONE)
        .dst_color_blend_factor(vk::BlendFactor::ONE_MINUS_SRC_ALPHA)
        .src_alpha_blend_factor(vk::BlendFactor::ONE)
        .dst_alpha_blend_factor(vk::BlendFactor::ONE_MINUS_SRC_ALPHA)
        .color_write_mask(vk::ColorComponentFlags::RGBA)];
    let blend = vk::PipelineColorBlendStateCreateInfo::default().attachments(&blend);
    let dynamic = [vk::DynamicState::VIEWPORT, vk::DynamicState::SCISSOR];
    let dynamic = vk::PipelineDynamicStateCreateInfo::default().dynamic_states(&dynamic);
    let formats = [FORMAT];
    let mut rendering = vk::PipelineRenderingCreateInfo::default()
        .color_attachment_formats(&formats)
        .depth_attachment_format(vk::Format::D32_SFLOAT);
    let create = [vk::GraphicsPipelineCreateInfo::default()
        .stages(&stages)
        .vertex_input_state(&vertices)
        .input_assembly_state(&assembly)
        .viewport_state(&viewport)
        .rasterization_state(&raster)
        .multisample_state(&samples)
        .depth_stencil_state(&depth)
        .color_blend_state(&blend)
        .dynamic_state(&dynamic)
        .layout(layout)
        .push_next(&mut rendering)];
    let made = unsafe { host.device.create_graphics_pipelines(vk::PipelineCache::null(), &create, None) };
    modules.into_iter().for_each(|m| unsafe { host.device.destroy_shader_module(m, None) });
    let raw = made.map_err(|(_, code)| code)?[0];
    Ok(Pipeline { raw, layout, set_layout })
}

fn pictures_set(
    host: &Vulkan,
    pipeline: &Pipeline,
    sampler: vk::Sampler,
    pictures: [Picture; 2],
) -> Result<(vk::DescriptorPool, vk::DescriptorSet)> {
    let kind = vk::DescriptorType::COMBINED_IMAGE_SAMPLER;
    let sizes = [vk::DescriptorPoolSize::default().ty(kind).descriptor_count(2)];
    let create = vk::DescriptorPoolCreateInfo::default().max_sets(1).pool_sizes(&sizes);
    let pool = unsafe { host.device.create_descriptor_pool(&create, None)? };
    let layouts = [pipeline.set_layout];
    let allocate = vk::DescriptorSetAllocateInfo::default().descriptor_pool(pool).set_layouts(&layouts);
    let set = unsafe { host.device.allocate_descriptor_sets(&allocate)? }[0];
    for (binding, picture) in (0..).zip(pictures) {
        let info = [vk::DescriptorImageInfo::default()
            .sampler(sampler)
            .image_view(picture.view)
            .image_layout(vk::ImageLayout::SHADER_READ_ONLY_OPTIMAL)];
        let write =
            vk::WriteDescriptorSet::default().dst_set(set).dst_binding(binding).descriptor_type(kind).image_info(&info);
        unsafe { host.device.update_descriptor_sets(&[write], &[]) };
    }
    Ok((pool, set))
}
