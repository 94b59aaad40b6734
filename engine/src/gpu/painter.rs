//! Draws textured triangles over a picture: what user interfaces are made of. The one graphics pipeline of the engine.
//!
//! Colours are premultiplied and blended as they are stored. Buffers grow and are kept, so that drawing allocates nothing
//! once the largest frame was seen.

use std::collections::BTreeMap;

use ash::vk;

use super::commands::Submission;
use super::device::{Gpu, vk_error};
use super::memory::{Buffer, Memory};
use super::texture::Texture;
use crate::error::Result;

/// Textures that may exist at a time, those that wait for their last frame included.
const MAX_TEXTURES: u32 = 64;
/// The compiled shaders.
pub const SHADERS: [(&str, &[u8]); 2] = [
    ("painter.vert", include_bytes!("../../../spirv_cache/painter.vert.spv")),
    ("painter.frag", include_bytes!("../../../spirv_cache/painter.frag.spv")),
];

/// A corner of a triangle.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct Vertex {
    /// Points, from the top left corner of the window.
    pub position: [f32; 2],
    /// 0 to 1 over the texture.
    pub uv: [f32; 2],
    /// Red, green, blue, alpha; premultiplied.
    pub color: [u8; 4],
}

/// Triangles with one texture.
#[derive(Debug, Clone, Copy)]
pub struct Mesh<'a> {
    /// Corners.
    pub vertices: &'a [Vertex],
    /// Three per triangle.
    pub indices: &'a [u32],
    /// Nothing is drawn outside: left, top, right, bottom, in points.
    pub clip: [f32; 4],
    /// Which texture; a mesh whose texture was never set is not drawn.
    pub texture: u64,
}

/// New contents of a texture, or of a part of it.
#[derive(Debug, Clone, Copy)]
pub struct TextureUpdate<'a> {
    /// Which texture.
    pub id: u64,
    /// Left and top of the part; `None`: the texture is made anew in this size.
    pub part: Option<[u32; 2]>,
    /// Width and height, texels.
    pub size: [u32; 2],
    /// `[H,W,4]` bytes, premultiplied.
    pub rgba: &'a [u8],
}

/// What is kept while a frame is in flight.
#[derive(Debug, Default)]
pub(super) struct Kept {
    vertices: Option<Buffer>,
    indices: Option<Buffer>,
    staging: Vec<Option<Buffer>>,
    retired: Vec<Texture>,
}

impl Kept {
    /// The host leaves its buffers alone until this submission has finished.
    pub(super) fn used_by(&self, submission: Submission) {
        let buffers = [&self.vertices, &self.indices].into_iter().chain(&self.staging);
        buffers.flatten().for_each(|buffer| buffer.used_by(submission));
    }
}

/// The pipeline and its textures.
pub(super) struct Painter {
    gpu: Gpu,
    pipeline: vk::Pipeline,
    layout: vk::PipelineLayout,
    set_layout: vk::DescriptorSetLayout,
    descriptors: vk::DescriptorPool,
    sampler: vk::Sampler,
    textures: BTreeMap<u64, Texture>,
}

impl Painter {
    pub(super) fn new(gpu: &Gpu, render_pass: vk::RenderPass) -> Result<Self> {
        let mut painter = Self {
            gpu: gpu.clone(),
            pipeline: vk::Pipeline::null(),
            layout: vk::PipelineLayout::null(),
            set_layout: vk::DescriptorSetLayout::null(),
            descriptors: vk::DescriptorPool::null(),
            sampler: vk::Sampler::null(),
            textures: BTreeMap::new(),
        };
        painter.create_layout()?;
        painter.pipeline = painter.create_pipeline(render_pass)?;
        Ok(painter)
    }

    fn create_layout(&mut self) -> Result<()> {
        let device = &self.gpu.0.device;
        let bindings = [vk::DescriptorSetLayoutBinding::default()
            .descriptor_type(vk::DescriptorType::COMBINED_IMAGE_SAMPLER)
            .descriptor_count(1)
            .stage_flags(vk::ShaderStageFlags::FRAGMENT)];
        let sets = vk::DescriptorSetLayoutCreateInfo::default().bindings(&bindings);
        let sizes = [vk::DescriptorPoolSize::default()
            .ty(vk::DescriptorType::COMBINED_IMAGE_SAMPLER)
            .descriptor_count(MAX_TEXTURES)];
        let pool = vk::DescriptorPoolCreateInfo::default()
            .flags(vk::DescriptorPoolCreateFlags::FREE_DESCRIPTOR_SET)
            .max_sets(MAX_TEXTURES)
            .pool_sizes(&sizes);
        let sampler = vk::SamplerCreateInfo::default()
            .mag_filter(vk::Filter::LINEAR)
            .min_filter(vk::Filter::LINEAR)
            .address_mode_u(vk::SamplerAddressMode::CLAMP_TO_EDGE)
            .address_mode_v(vk::SamplerAddressMode::CLAMP_TO_EDGE);
        let push = [vk::PushConstantRange::default().stage_flags(vk::ShaderStageFlags::VERTEX).size(8)];
        // SAFETY: plain creation; `Drop` destroys what was made.
        unsafe {
            self.set_layout =
                device.create_descriptor_set_layout(&sets, None).map_err(vk_error("vkCreateDescriptorSetLayout"))?;
            self.descriptors =
                device.create_descriptor_pool(&pool, None).map_err(vk_error("vkCreateDescriptorPool"))?;
            self.sampler = device.create_sampler(&sampler, None).map_err(vk_error("vkCreateSampler"))?;
            let layouts = [self.set_layout];
            let layout = vk::PipelineLayoutCreateInfo::default().set_layouts(&layouts).push_constant_ranges(&push);
            self.layout = device.create_pipeline_layout(&layout, None).map_err(vk_error("vkCreatePipelineLayout"))?;
        }
        Ok(())
    }

    fn create_pipeline(&self, render_pass: vk::RenderPass) -> Result<vk::Pipeline> {
        let device = &self.gpu.0.device;
        let mut modules = [vk::ShaderModule::null(); 2];
        for (module, (_, bytes)) in modules.iter_mut().zip(SHADERS) {
            let words: Vec<u32> = bytes.chunks_exact(4).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect();
            // SAFETY: committed SPIR-V that spirv-val accepts.
            *module = unsafe { device.create_shader_module(&vk::ShaderModuleCreateInfo::default().code(&words), None) }
                .map_err(vk_error("vkCreateShaderModule"))?;
        }
        let made = self.create_pipeline_of(render_pass, modules);
        for module in modules {
            // SAFETY: a pipeline keeps no reference to its modules.
            unsafe { device.destroy_shader_module(module, None) };
        }
        made
    }

    fn create_pipeline_of(
        &self,
        render_pass: vk::RenderPass,
        [vertex, fragment]: [vk::ShaderModule; 2],
    ) -> Result<vk::Pipeline> {
        let stage =
            |flag, module| vk::PipelineShaderStageCreateInfo::default().stage(flag).module(module).name(c"main");
        let stages = [stage(vk::ShaderStageFlags::VERTEX, vertex), stage(vk::ShaderStageFlags::FRAGMENT, fragment)];
        let bindings = [vk::VertexInputBindingDescription::default().stride(size_of::<Vertex>() as u32)];
        let attribute = |location, format, offset| {
            vk::VertexInputAttributeDescription::default().location(location).format(format).offset(offset)
        };
        let attributes = [
            attribute(0, vk::Format::R32G32_SFLOAT, 0),
            attribute(1, vk::Format::R32G32_SFLOAT, 8),
            attribute(2, vk::Format::R8G8B8A8_UNORM, 16),
        ];
        let input = vk::PipelineVertexInputStateCreateInfo::default()
            .vertex_binding_descriptions(&bindings)
            .vertex_attribute_descriptions(&attributes);
        let assembly =
            vk::PipelineInputAssemblyStateCreateInfo::default().topology(vk::PrimitiveTopology::TRIANGLE_LIST);
        let viewport = vk::PipelineViewportStateCreateInfo::default().viewport_count(1).scissor_count(1);
        let raster = vk::PipelineRasterizationStateCreateInfo::default()
            .polygon_mode(vk::PolygonMode::FILL)
            .cull_mode(vk::CullModeFlags::NONE)
            .line_width(1.0);
        let samples =
            vk::PipelineMultisampleStateCreateInfo::default().rasterization_samples(vk::SampleCountFlags::TYPE_1);
        let (one, rest) = (vk::BlendFactor::ONE, vk::BlendFactor::ONE_MINUS_SRC_ALPHA);
        let blends = [vk::PipelineColorBlendAttachmentState::default()
            .blend_enable(true)
            .src_color_blend_factor(one)
            .dst_color_blend_factor(rest)
            .src_alpha_blend_factor(one)
            .dst_alpha_blend_factor(rest)
            .color_write_mask(vk::ColorComponentFlags::RGBA)];
        let blend = vk::PipelineColorBlendStateCreateInfo::default().attachments(&blends);
        let states = [vk::DynamicState::VIEWPORT, vk::DynamicState::SCISSOR];
        let dynamic = vk::PipelineDynamicStateCreateInfo::default().dynamic_states(&states);
        let create = [vk::GraphicsPipelineCreateInfo::default()
            .stages(&stages)
            .vertex_input_state(&input)
            .input_assembly_state(&assembly)
            .viewport_state(&viewport)
            .rasterization_state(&raster)
            .multisample_state(&samples)
            .color_blend_state(&blend)
            .dynamic_state(&dynamic)
            .layout(self.layout)
            .render_pass(render_pass)];
        // SAFETY: every state that the create info points to lives until the call returns.
        let made = unsafe { self.gpu.0.device.create_graphics_pipelines(self.gpu.0.cache.raw, &create, None) };
        made.map(|list| list[0]).map_err(|(_, code)| self.gpu.vulkan_error("vkCreateGraphicsPipelines", code))
    }

    /// Records copies to textures. `kept` holds what the copies read, and textures that were replaced.
    pub(super) fn update(
        &mut self,
        commands: vk::CommandBuffer,
        kept: &mut Kept,
        updates: &[TextureUpdate<'_>],
    ) -> Result<()> {
        kept.retired.clear();
        for (i, update) in updates.iter().filter(|u| !u.size.contains(&0)).enumerate() {
            if i == kept.staging.len() {
                kept.staging.push(None);
            }
            let staging = self.room(&mut kept.staging[i], "texture staging", update.rgba.len() as u64)?.clone();
            staging.write(0, update.rgba)?;
            let offset = match update.part {
                Some(offset) => offset,
                None => {
                    let texture =
                        Texture::new(&self.gpu, update.size, self.descriptors, self.set_layout, self.sampler)?;
                    kept.retired.extend(self.textures.insert(update.id, texture));
                    [0, 0]
                }
            };
            if let Some(texture) = self.textures.get_mut(&update.id) {
                texture.record_copy(commands, &staging, offset, update.size);
            }
        }
        Ok(())
    }

    /// A texture goes when the frame that `kept` belongs to has finished.
    pub(super) fn forget(&mut self, kept: &mut Kept, texture: u64) {
        kept.retired.extend(self.textures.remove(&texture));
    }

    /// Writes all triangles to the frame's buffers. `meshes` is called twice.
    pub(super) fn upload<'a, I: Iterator<Item = Mesh<'a>>>(
        &self,
        kept: &mut Kept,
        meshes: impl Fn() -> I,
    ) -> Result<()> {
        let (vertices, indices) =
            meshes().fold((0, 0), |(v, i), m| (v + m.vertices.len() as u64, i + m.indices.len() as u64));
        let vertex_buffer =
            self.room(&mut kept.vertices, "interface vertices", vertices * size_of::<Vertex>() as u64)?;
        let index_buffer = self.room(&mut kept.indices, "interface indices", indices * 4)?;
        let (mut v, mut i) = (0, 0);
        for mesh in meshes() {
            vertex_buffer.write(v, bytemuck::cast_slice(mesh.vertices))?;
            index_buffer.write(i, bytemuck::cast_slice(mesh.indices))?;
            v += size_of_val(mesh.vertices) as u64;
            i += size_of_val(mesh.indices) as u64;
        }
        Ok(())
    }

    fn room<'a>(&self, buffer: &'a mut Option<Buffer>, name: &str, bytes: u64) -> Result<&'a Buffer> {
        if buffer.as_ref().is_some_and(|b| b.bytes() < bytes) {
            *buffer = None;
        }
        match buffer {
            Some(found) => Ok(found),
            None => Ok(buffer.insert(self.gpu.buffer(name, bytes.next_power_of_two().max(1 << 16), Memory::Upload)?)),
        }
    }

    /// Records the triangles inside a render pass over an image of `size` pixels.
    pub(super) fn draw<'a>(
        &self,
        commands: vk::CommandBuffer,
        kept: &Kept,
        meshes: impl Iterator<Item = Mesh<'a>>,
        size: [u32; 2],
        pixels_per_point: f32,
    ) {
        let (Some(vertices), Some(indices)) = (&kept.vertices, &kept.indices) else { return };
        let device = &self.gpu.0.device;
        let [width, height] = size.map(|s| s as f32);
        let viewport = [vk::Viewport { x: 0.0, y: 0.0, width, height, min_depth: 0.0, max_depth: 1.0 }];
        let clip_from_points = [2.0 * pixels_per_point / width, 2.0 * pixels_per_point / height];
        // SAFETY: recording inside the render pass that the pipeline was made for; all handles are live and kept.
        unsafe {
            device.cmd_bind_pipeline(commands, vk::PipelineBindPoint::GRAPHICS, self.pipeline);
            device.cmd_set_viewport(commands, 0, &viewport);
            let push = bytemuck::bytes_of(&clip_from_points);
            device.cmd_push_constants(commands, self.layout, vk::ShaderStageFlags::VERTEX, 0, push);
            device.cmd_bind_vertex_buffers(commands, 0, &[vertices.raw()], &[0]);
            device.cmd_bind_index_buffer(commands, indices.raw(), 0, vk::IndexType::UINT32);
        }
        let (mut first_vertex, mut first_index) = (0, 0);
        for mesh in meshes {
            let count = mesh.indices.len() as u32;
            if let (Some(scissor), Some(texture)) =
                (scissor(mesh.clip, pixels_per_point, size), self.textures.get(&mesh.texture))
            {
                // SAFETY: as above; the ranges lie in the buffers that `upload` filled from the same meshes.
                unsafe {
                    device.cmd_set_scissor(commands, 0, &[scissor]);
                    let sets = [texture.set];
                    let point = vk::PipelineBindPoint::GRAPHICS;
                    device.cmd_bind_descriptor_sets(commands, point, self.layout, 0, &sets, &[]);
                    device.cmd_draw_indexed(commands, count, 1, first_index, first_vertex, 0);
                }
            }
            first_vertex += mesh.vertices.len() as i32;
            first_index += count;
        }
    }
}

impl Drop for Painter {
    fn drop(&mut self) {
        self.textures.clear();
        let device = &self.gpu.0.device;
        // SAFETY: the presenter waits for the device before it drops its parts; null handles are ignored.
        unsafe {
            device.destroy_pipeline(self.pipeline, None);
            device.destroy_pipeline_layout(self.layout, None);
            device.destroy_sampler(self.sampler, None);
            device.destroy_descriptor_pool(self.descriptors, None);
            device.destroy_descriptor_set_layout(self.set_layout, None);
        }
    }
}

/// The part of the image inside `clip` (points), pixels; `None` when it is empty.
fn scissor(clip: [f32; 4], pixels_per_point: f32, size: [u32; 2]) -> Option<vk::Rect2D> {
    let edge = |v: f32, most: u32| ((v * pixels_per_point).round().max(0.0) as u32).min(most);
    let [left, right] = [edge(clip[0], size[0]), edge(clip[2], size[0])];
    let [top, bottom] = [edge(clip[1], size[1]), edge(clip[3], size[1])];
    (left < right && top < bottom).then(|| vk::Rect2D {
        offset: vk::Offset2D { x: left as i32, y: top as i32 },
        extent: vk::Extent2D { width: right - left, height: bottom - top },
    })
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]
    use super::*;

    #[test]
    fn scissors_stay_inside_the_image() {
        let whole = scissor([-10.0, -3.0, 1e9, f32::INFINITY], 2.0, [100, 50]).unwrap();
        assert_eq!((whole.offset.x, whole.offset.y), (0, 0));
        assert_eq!((whole.extent.width, whole.extent.height), (100, 50));
        let part = scissor([10.0, 5.0, 20.0, 15.0], 2.0, [100, 50]).unwrap();
        assert_eq!((part.offset.x, part.offset.y, part.extent.width, part.extent.height), (20, 10, 20, 20));
        assert!(scissor([60.0, 0.0, 70.0, 10.0], 2.0, [100, 50]).is_none());
        assert!(scissor([5.0, 5.0, 5.0, 9.0], 1.0, [100, 50]).is_none());
        assert!(scissor([f32::NAN, 0.0, f32::NAN, 9.0], 1.0, [100, 50]).is_none());
    }
}
