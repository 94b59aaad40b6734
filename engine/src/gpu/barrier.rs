//! Barriers in Vulkan's terms.

use ash::vk;

use super::access::Stages;

/// All stages of `destination` wait for those of `source`; `flush`: and see what these wrote. `crumbs`: breadcrumbs wait too.
pub(super) fn memory_barrier(
    source: Stages,
    flush: bool,
    destination: Stages,
    crumbs: bool,
) -> vk::MemoryBarrier2<'static> {
    // A breadcrumb is a transfer that must not overtake the kernels before it.
    let crumb = if crumbs { vk::PipelineStageFlags2::TRANSFER } else { vk::PipelineStageFlags2::NONE };
    let barrier =
        vk::MemoryBarrier2::default().src_stage_mask(stages(source)).dst_stage_mask(stages(destination) | crumb);
    if flush {
        barrier.src_access_mask(writes(source)).dst_access_mask(reads(destination) | writes(destination))
    } else {
        barrier
    }
}

fn stages(s: Stages) -> vk::PipelineStageFlags2 {
    let mut flags = vk::PipelineStageFlags2::NONE;
    for (stage, flag) in [
        (Stages::COMPUTE, vk::PipelineStageFlags2::COMPUTE_SHADER),
        (Stages::TRANSFER, vk::PipelineStageFlags2::TRANSFER),
        (Stages::INDIRECT, vk::PipelineStageFlags2::DRAW_INDIRECT),
        (Stages::HOST, vk::PipelineStageFlags2::HOST),
    ] {
        if s.contains(stage) {
            flags |= flag;
        }
    }
    flags
}

fn writes(s: Stages) -> vk::AccessFlags2 {
    let mut flags = vk::AccessFlags2::NONE;
    if s.contains(Stages::COMPUTE) {
        flags |= vk::AccessFlags2::SHADER_STORAGE_WRITE;
    }
    if s.contains(Stages::TRANSFER) {
        flags |= vk::AccessFlags2::TRANSFER_WRITE;
    }
    flags
}

fn reads(s: Stages) -> vk::AccessFlags2 {
    let mut flags = vk::AccessFlags2::NONE;
    for (stage, flag) in [
        (Stages::COMPUTE, vk::AccessFlags2::SHADER_STORAGE_READ),
        (Stages::TRANSFER, vk::AccessFlags2::TRANSFER_READ),
        (Stages::INDIRECT, vk::AccessFlags2::INDIRECT_COMMAND_READ),
        (Stages::HOST, vk::AccessFlags2::HOST_READ),
    ] {
        if s.contains(stage) {
            flags |= flag;
        }
    }
    flags
}
