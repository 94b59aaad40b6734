//! `spgs devices`.

use engine::error::Result;
use engine::gpu::capability::REQUIREMENTS;
use engine::gpu::{DeviceInfo, devices};
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
        "    memory    {:.0} MiB on the device, {:.0} MiB per allocation, {:.0} MiB per binding",
        mib(c.device_heap_bytes),
        mib(c.max_allocation_bytes),
        mib(c.max_storage_buffer_range)
    ));
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
