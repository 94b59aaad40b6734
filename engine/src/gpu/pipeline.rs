//! Compute pipelines from kernel declarations, and the pipeline cache on disk.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::io::Write as _;
use std::path::PathBuf;

use ash::vk;

use super::device::{Gpu, lock, vk_error};
use super::kernel::{Binding, Element, Kernel};
use super::spirv;
use super::texels::{Texels, with_texel_reads};
use crate::error::{Error, Result};

/// A compute pipeline with its layouts. Lives as long as the device.
#[derive(Debug, Clone, Copy)]
pub(super) struct Pipeline {
    pub(super) raw: vk::Pipeline,
    pub(super) layout: vk::PipelineLayout,
    pub(super) set_layout: vk::DescriptorSetLayout,
    pub(super) texels: Texels,
}

#[derive(Debug, Clone, Copy)]
struct Interface {
    module: vk::ShaderModule,
    layout: vk::PipelineLayout,
    set_layout: vk::DescriptorSetLayout,
    texels: Texels,
}

/// Everything made from SPIR-V so far.
#[derive(Debug, Default)]
pub(super) struct Pipelines {
    /// By kernel and threads of a workgroup.
    interfaces: BTreeMap<(&'static str, u32), Interface>,
    /// By kernel and all its specialisation constants.
    pipelines: HashMap<(&'static str, Vec<u32>), (&'static Kernel, Pipeline)>,
}

impl Pipelines {
    /// Every pipeline with its kernel and constants, in no order.
    pub(super) fn all(&self) -> impl Iterator<Item = (&'static Kernel, &[u32], vk::Pipeline)> {
        self.pipelines.iter().map(|((_, constants), (kernel, p))| (*kernel, constants.as_slice(), p.raw))
    }

    pub(super) fn destroy(&mut self, device: &ash::Device) {
        // SAFETY: called once, when the device is idle and about to be destroyed.
        unsafe {
            for (_, (_, p)) in self.pipelines.drain() {
                device.destroy_pipeline(p.raw, None);
            }
            for i in std::mem::take(&mut self.interfaces).into_values() {
                device.destroy_shader_module(i.module, None);
                device.destroy_pipeline_layout(i.layout, None);
                device.destroy_descriptor_set_layout(i.set_layout, None);
            }
        }
    }
}

impl Gpu {
    /// The pipeline of a kernel for these specialisation constants (ids 1…; id 0 is the kernel's subgroup size); made once.
    pub(super) fn pipeline(&self, kernel: &'static Kernel, spec: &[u32]) -> Result<Pipeline> {
        let mut constants = vec![self.subgroup_size_of(kernel)];
        constants.extend_from_slice(spec);
        if constants.len() != kernel.spec.len() {
            let why = format!("{} specialisation constants given, {} declared", constants.len(), kernel.spec.len());
            return Err(Error::Kernel { kernel: kernel.name.into(), why });
        }
        let mut pipelines = lock(&self.0.pipelines);
        let key = (kernel.name, constants);
        if let Some((_, found)) = pipelines.pipelines.get(&key) {
            return Ok(*found);
        }
        let threads = kernel.threads(&key.1);
        let interface = match pipelines.interfaces.get(&(kernel.name, threads)) {
            Some(found) => *found,
            None => {
                let made = self.interface(kernel, threads)?;
                pipelines.interfaces.insert((kernel.name, threads), made);
                made
            }
        };
        let pipeline = self.create_pipeline(interface, &key.1)?;
        pipelines.pipelines.insert(key, (kernel, pipeline));
        Ok(pipeline)
    }

    /// Makes the pipeline of a kernel for these specialisation constants (from id 1 on), without a use for it yet.
    ///
    /// # Errors
    /// `Kernel` when the constants or the SPIR-V do not fit the declaration; `Vulkan` when the driver fails.
    pub fn compile(&self, kernel: &'static Kernel, spec: &[u32]) -> Result<()> {
        self.pipeline(kernel, spec).map(|_| ())
    }

    /// Names of the kernels that have a pipeline by now.
    #[doc(hidden)]
    pub fn compiled_names(&self) -> BTreeSet<&'static str> {
        lock(&self.0.pipelines).interfaces.keys().map(|(name, _)| *name).collect()
    }

    /// Module and layouts, after checking the SPIR-V against the declaration.
    fn interface(&self, kernel: &'static Kernel, threads: u32) -> Result<Interface> {
        spirv::check(kernel, &spirv::reflect(kernel)?)?;
        let device = &self.0.device;
        let replaced = self.0.options.replace_spirv.iter().find(|(name, _)| *name == kernel.name);
        let words = replaced.map_or_else(|| spirv::words(kernel), |(_, words)| Ok(words.clone()))?;
        let words = if threads == kernel.local_size { words } else { spirv::with_local_size(&words, threads) };
        let words = self.0.info.capabilities.reconvergence.ask(words);
        let (words, texels) = self.with_texel_reads(kernel, words);
        let type_of = |(binding, declared): (u32, &Binding)| match (declared.element, texels.format(binding)) {
            (Element::Image, _) => (binding, vk::DescriptorType::STORAGE_IMAGE),
            (_, Some(_)) => (binding, vk::DescriptorType::STORAGE_TEXEL_BUFFER),
            _ => (binding, vk::DescriptorType::STORAGE_BUFFER),
        };
        let second = texels.second().map(|binding| (binding, vk::DescriptorType::STORAGE_TEXEL_BUFFER));
        let bindings: Vec<_> = (0..)
            .zip(kernel.bindings)
            .map(type_of)
            .chain(second)
            .map(|(binding, ty)| {
                vk::DescriptorSetLayoutBinding::default()
                    .binding(binding)
                    .descriptor_type(ty)
                    .descriptor_count(1)
                    .stage_flags(vk::ShaderStageFlags::COMPUTE)
            })
            .collect();
        let set_create = vk::DescriptorSetLayoutCreateInfo::default().bindings(&bindings);
        // SAFETY: plain creation.
        let set_layout = unsafe { device.create_descriptor_set_layout(&set_create, None) }
            .map_err(vk_error("vkCreateDescriptorSetLayout"))?;
        let ranges = [vk::PushConstantRange::default()
            .stage_flags(vk::ShaderStageFlags::COMPUTE)
            .size(kernel.push_bytes().max(4))];
        let set_layouts = [set_layout];
        let mut layout_create = vk::PipelineLayoutCreateInfo::default().set_layouts(&set_layouts);
        if kernel.push_bytes() > 0 {
            layout_create = layout_create.push_constant_ranges(&ranges);
        }
        // SAFETY: plain creation.
        let layout = unsafe { device.create_pipeline_layout(&layout_create, None) };
        let module_create = vk::ShaderModuleCreateInfo::default().code(&words);
        // SAFETY: the words passed naga's parser and, in the tests, spirv-val, also with what was asked for.
        let module = unsafe { device.create_shader_module(&module_create, None) };
        match (layout, module) {
            (Ok(layout), Ok(module)) => Ok(Interface { module, layout, set_layout, texels }),
            (layout, module) => {
                let code = layout.err().or(module.err()).unwrap_or(vk::Result::ERROR_UNKNOWN);
                // SAFETY: unused; destroying a null handle does nothing.
                unsafe {
                    device.destroy_pipeline_layout(layout.unwrap_or_default(), None);
                    device.destroy_shader_module(module.unwrap_or_default(), None);
                    device.destroy_descriptor_set_layout(set_layout, None);
                }
                Err(vk_error("vkCreateShaderModule / vkCreatePipelineLayout")(code))
            }
        }
    }

    /// What the kernel reads as texels on this device, if anything; its image, if it stores to one, is one of what a stage may have.
    fn with_texel_reads(&self, kernel: &Kernel, words: Vec<u32>) -> (Vec<u32>, Texels) {
        let images = u32::from(kernel.buffers().1);
        let most = self.0.info.capabilities.texel_reads.saturating_sub(images);
        if most == 0 || !self.0.options.texel_reads {
            return (words, Texels::default());
        }
        with_texel_reads(&words, kernel.bindings, most)
    }

    /// `constants`: from id 0, the subgroup size, on.
    fn create_pipeline(&self, interface: Interface, constants: &[u32]) -> Result<Pipeline> {
        let entries: Vec<_> = (0..constants.len() as u32)
            .map(|id| vk::SpecializationMapEntry { constant_id: id, offset: id * 4, size: 4 })
            .collect();
        let specialization =
            vk::SpecializationInfo::default().map_entries(&entries).data(bytemuck::cast_slice(constants));
        let capabilities = &self.0.info.capabilities;
        let mut pinned =
            vk::PipelineShaderStageRequiredSubgroupSizeCreateInfo::default().required_subgroup_size(constants[0]);
        let mut stage = vk::PipelineShaderStageCreateInfo::default()
            .stage(vk::ShaderStageFlags::COMPUTE)
            .flags(vk::PipelineShaderStageCreateFlags::REQUIRE_FULL_SUBGROUPS)
            .module(interface.module)
            .name(c"main")
            .specialization_info(&specialization);
        // Pinning limits the workgroup to maxComputeWorkgroupSubgroups, so a fixed size is left alone.
        if capabilities.min_subgroup_size != capabilities.max_subgroup_size {
            stage = stage.push_next(&mut pinned);
        }
        let flags = if self.0.statistics {
            vk::PipelineCreateFlags::CAPTURE_STATISTICS_KHR
        } else {
            vk::PipelineCreateFlags::empty()
        };
        let create = [vk::ComputePipelineCreateInfo::default().flags(flags).stage(stage).layout(interface.layout)];
        // SAFETY: interface and constants were checked against the SPIR-V.
        let made = unsafe { self.0.device.create_compute_pipelines(self.0.cache.raw, &create, None) };
        match made {
            Ok(list) => {
                let Interface { layout, set_layout, texels, .. } = interface;
                Ok(Pipeline { raw: list[0], layout, set_layout, texels })
            }
            Err((_, code)) => Err(self.vulkan_error("vkCreateComputePipelines", code)),
        }
    }
}

impl Kernel {
    /// Size of the push-constant block: one word past the last member (all members are 4 bytes wide).
    pub fn push_bytes(&self) -> u32 {
        self.push.last().map_or(0, |(_, offset)| offset + 4)
    }
}

/// `VkPipelineCache` and the file it is kept in. Drivers check the header themselves; a file that they do not accept is
/// simply not used.
pub(super) struct PipelineCacheFile {
    pub(super) raw: vk::PipelineCache,
    path: Option<PathBuf>,
    loaded_bytes: usize,
}

impl PipelineCacheFile {
    pub(super) fn open(device: &ash::Device, path: Option<PathBuf>) -> Result<Self> {
        let data = path.as_ref().and_then(|p| std::fs::read(p).ok()).unwrap_or_default();
        let create = vk::PipelineCacheCreateInfo::default().initial_data(&data);
        // SAFETY: the driver validates the data.
        let raw = unsafe { device.create_pipeline_cache(&create, None) }
            .or_else(|_| {
                // SAFETY: an empty cache.
                unsafe { device.create_pipeline_cache(&vk::PipelineCacheCreateInfo::default(), None) }
            })
            .map_err(vk_error("vkCreatePipelineCache"))?;
        Ok(Self { raw, path, loaded_bytes: data.len() })
    }

    /// Writes the cache if it grew. Failing to is no error: the next start is only slower.
    ///
    /// # Safety
    /// The device must be idle and the cache unused afterwards.
    pub(super) unsafe fn save_and_destroy(&self, device: &ash::Device) {
        // SAFETY: promised by the caller.
        let data = unsafe { device.get_pipeline_cache_data(self.raw) }.unwrap_or_default();
        if let Some(path) = &self.path
            && data.len() != self.loaded_bytes
            && let Err(error) = save(path, &data)
        {
            log::debug!("pipeline cache {}: {error}", path.display());
        }
        // SAFETY: promised by the caller.
        unsafe { device.destroy_pipeline_cache(self.raw, None) };
    }
}

fn save(path: &std::path::Path, data: &[u8]) -> std::io::Result<()> {
    let folder = path.parent().ok_or(std::io::ErrorKind::NotFound)?;
    std::fs::create_dir_all(folder)?;
    let mut file = tempfile::NamedTempFile::new_in(folder)?;
    file.write_all(data)?;
    file.as_file().sync_all()?;
    file.persist(path)?;
    Ok(())
}
