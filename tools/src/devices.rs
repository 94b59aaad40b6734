//! `spgs devices`.

use engine::error::Result;
use engine::gpu::capability::REQUIREMENTS;
use engine::gpu::{Capabilities, DeviceInfo, devices};
use serde_json::{Value, json};

use crate::args::DevicesArgs;
use crate::{gpu_session, output};

/// Lists the devices.
pub fn run(args: &DevicesArgs) -> Result<()> {
    let list = devices()?;
    if args.json {
        return output::json(&Value::Array(list.iter().map(describe_json).collect()));
    }
    if list.is_empty() {
        output::line("no Vulkan device; run ci/setup");
    }
    for info in &list {
        describe(info);
    }
    Ok(())
}

fn describe_json(info: &DeviceInfo) -> Value {
    let requirements: Vec<Value> = REQUIREMENTS
        .iter()
        .map(|r| json!({ "name": r.name, "required": r.required, "met": (r.met)(&info.capabilities), "why": r.why }))
        .collect();
    json!({ "device": info, "usable": info.missing().is_empty(), "missing": info.missing(), "requirements": requirements })
}

/// The family that kernels run on, and what else it can do.
fn queue(c: &Capabilities) -> String {
    let family = c.compute_family.and_then(|index| Some((index, c.queue_families.get(index as usize)?)));
    let Some((index, family)) = family else { return "none that computes".to_owned() };
    let what = if family.graphics { "computes and draws" } else { "computes only" };
    let count = c.queue_families.len();
    format!("family {index} of {count} ({what}), timestamps of {} bits", family.timestamp_bits)
}

fn describe(info: &DeviceInfo) {
    let c = &info.capabilities;
    let mib = |bytes: u64| bytes as f64 / f64::from(1 << 20);
    output::line(&format!("[{}] {}", info.index, info.name));
    output::line(&format!("    type      {}, Vulkan {}", info.kind, info.vulkan));
    output::line(&format!("    driver    {}", info.driver));
    output::line(&format!(
        "    subgroups {} used ({} to {} possible)",
        gpu_session::subgroup_sizes(|kernel| info.subgroup_size_of(kernel, None)),
        c.min_subgroup_size,
        c.max_subgroup_size
    ));
    output::line(&format!(
        "    memory    {:.0} MiB on the device ({}), {:.0} MiB per allocation, {:.0} MiB per binding",
        mib(c.device_heap.bytes),
        c.device_heap.free.map_or("does not tell what is free".to_owned(), |free| format!("{:.0} free", mib(free))),
        mib(c.max_allocation_bytes),
        mib(c.max_storage_buffer_range)
    ));
    let constants = if c.device_upload { "on the device" } else { "by the host, copied to the device" };
    output::line(&format!("    constants written {constants}; at most {:.0} MiB used", mib(c.device_heap.budget(0))));
    output::line(&format!("    queue     {}", queue(c)));
    output::line(&format!(
        "    limits    {} workgroups in x, {} invocations, {} bytes shared, {} storage buffers",
        c.max_groups_x, c.max_workgroup_size, c.max_shared_bytes, c.max_storage_buffers
    ));
    for r in REQUIREMENTS {
        let state = match ((r.met)(c), r.required) {
            (true, _) => "yes",
            (false, true) => "NO ",
            (false, false) => "no ",
        };
        let kind = if r.required { "required" } else { "optional" };
        output::line(&format!("    {state} {kind}  {} ({})", r.name, r.why));
    }
    let verdict = match info.missing() {
        missing if missing.is_empty() => "usable".to_owned(),
        missing => format!("not usable: lacks {}", missing.join(", ")),
    };
    output::line(&format!("    => {verdict}"));
}
