//! What the driver's compiler made of each pipeline (`VK_KHR_pipeline_executable_properties`).

use ash::vk;

use super::device::{Gpu, lock};
use super::kernel::Kernel;
use crate::error::{Error, Result};

/// A value that a compiler reports.
#[derive(Debug, Clone, PartialEq)]
pub struct Statistic {
    /// Its name, as the driver gives it: `VGPRs`, `Scratch size`.
    pub name: String,
    /// Its value; flags are 0 or 1.
    pub value: f64,
}

/// A pipeline and its statistics.
#[derive(Debug, Clone)]
pub struct CompiledKernel {
    /// The kernel.
    pub kernel: &'static Kernel,
    /// Specialisation constants, from id 0 (the subgroup size) on.
    pub constants: Vec<u32>,
    /// The subgroup size that the driver compiled for, by its own word.
    pub subgroup_size: u32,
    /// In the driver's order.
    pub statistics: Vec<Statistic>,
}

impl Gpu {
    /// Every pipeline made so far, by kernel and constants.
    ///
    /// # Errors
    /// `Usage` when [`GpuOptions::statistics`](super::GpuOptions::statistics) is off or the driver has none; `Vulkan` when it
    /// fails.
    pub fn compiled_kernels(&self) -> Result<Vec<CompiledKernel>> {
        if !self.0.statistics {
            return Err(Error::usage(
                "statistics of pipelines",
                format!("{}, which reports none", self.0.info.name),
                "a device with VK_KHR_pipeline_executable_properties, opened for statistics",
            ));
        }
        let functions = ash::khr::pipeline_executable_properties::Device::new(&self.0.instance, &self.0.device);
        let mut all = Vec::new();
        for (kernel, constants, pipeline) in lock(&self.0.pipelines).all() {
            let (subgroup_size, statistics) = self.statistics_of(&functions, pipeline)?;
            all.push(CompiledKernel { kernel, constants: constants.to_vec(), subgroup_size, statistics });
        }
        all.sort_by(|a, b| (a.kernel.name, &a.constants).cmp(&(b.kernel.name, &b.constants)));
        Ok(all)
    }

    fn statistics_of(
        &self,
        functions: &ash::khr::pipeline_executable_properties::Device,
        pipeline: vk::Pipeline,
    ) -> Result<(u32, Vec<Statistic>)> {
        let fail = |code| self.vulkan_error("vkGetPipelineExecutableStatisticsKHR", code);
        let info = vk::PipelineInfoKHR::default().pipeline(pipeline);
        // SAFETY: the pipeline is live and was made with CAPTURE_STATISTICS.
        let executables = unsafe { functions.get_pipeline_executable_properties(&info) }.map_err(fail)?;
        let mut statistics = Vec::new();
        for index in 0..executables.len() as u32 {
            let info = vk::PipelineExecutableInfoKHR::default().pipeline(pipeline).executable_index(index);
            // SAFETY: as above.
            let list = unsafe { functions.get_pipeline_executable_statistics(&info) }.map_err(fail)?;
            statistics.extend(list.iter().map(statistic));
        }
        Ok((executables.first().map_or(0, |e| e.subgroup_size), statistics))
    }
}

fn statistic(s: &vk::PipelineExecutableStatisticKHR<'_>) -> Statistic {
    // SAFETY: `format` says which member of the union the driver wrote.
    let value = unsafe {
        match s.format {
            vk::PipelineExecutableStatisticFormatKHR::BOOL32 => f64::from(s.value.b32),
            vk::PipelineExecutableStatisticFormatKHR::INT64 => s.value.i64 as f64,
            vk::PipelineExecutableStatisticFormatKHR::UINT64 => s.value.u64 as f64,
            _ => s.value.f64,
        }
    };
    let name = s.name_as_c_str().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    Statistic { name, value }
}
