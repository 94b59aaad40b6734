//! `spgs devices`.

use engine::error::Result;
use engine::gpu::capability::REQUIREMENTS;
use engine::gpu::{Capabilities, DeviceInfo, Gpu, GpuOptions, SelfTest, devices};
use engine::self_test::{self, Suite, Verdict};
use serde_json::{Value, json};

use crate::cli::args::{DevicesArgs, Global};
use crate::cli::{gpu_session, output};

/// Lists the devices and what is known of them; with `--self-test` after testing each one that is usable.
pub fn run(args: &DevicesArgs, global: &Global) -> Result<()> {
    let list = devices()?;
    if global.self_test {
        list.iter().filter(|info| info.missing().is_empty()).for_each(test);
    }
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

/// Runs what a device can be tested for; the verdicts are kept and read again below.
fn test(info: &DeviceInfo) {
    let options =
        GpuOptions { device: Some(info.index.to_string()), self_test: SelfTest::Skip, ..GpuOptions::default() };
    let tested = Gpu::open(&options).map(|gpu| {
        for suite in Suite::ALL.into_iter().filter(|suite| suite.fits(info)) {
            if let Err(error) = gpu.self_test(suite) {
                log::warn!("{error}");
            }
        }
    });
    if let Err(error) = tested {
        log::warn!("[{}] {}: {error}", info.index, info.name);
    }
}

fn known(info: &DeviceInfo, suite: Suite) -> Option<Verdict> {
    self_test::known(info, &GpuOptions::default(), suite)
}

/// What is known of a device, as a part of a line.
fn describe_verdict(info: &DeviceInfo, suite: Suite) -> String {
    let name = suite.name();
    match known(info, suite) {
        _ if !suite.fits(info) => format!("{name}: not possible"),
        None => format!("{name}: never run"),
        Some(verdict) => {
            let outcome = verdict.failure.as_ref().map_or("passed".to_owned(), |why| format!("FAILED, {why}"));
            format!("{name}: {outcome} ({} ago, took {:.2} s)", age(verdict.age_s()), verdict.seconds)
        }
    }
}

/// Seconds in the largest unit that they fill.
fn age(seconds: u64) -> String {
    let units = [("day", 86_400), ("hour", 3600), ("minute", 60), ("second", 1)];
    let (name, length) = units.into_iter().find(|(_, length)| seconds >= *length).unwrap_or(("second", 1));
    let count = seconds / length;
    format!("{count} {name}{}", if count == 1 { "" } else { "s" })
}

fn describe_json(info: &DeviceInfo) -> Value {
    let requirements: Vec<Value> = REQUIREMENTS
        .iter()
        .map(|r| json!({ "name": r.name, "required": r.required, "met": (r.met)(&info.capabilities), "why": r.why }))
        .collect();
    let verdicts = Suite::ALL.map(|suite| (suite.name().to_owned(), json!(known(info, suite))));
    json!({
        "device": info,
        "usable": info.missing().is_empty() && !fails(info),
        "missing": info.missing(),
        "self_test": Value::Object(verdicts.into_iter().collect()),
        "requirements": requirements,
    })
}

/// Whether the device is known to draw wrong pictures.
fn fails(info: &DeviceInfo) -> bool {
    Suite::ALL.into_iter().filter(|suite| !suite.trains()).any(|suite| known(info, suite).is_some_and(|v| !v.passed()))
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
    for suite in Suite::ALL.into_iter().filter(|_| info.missing().is_empty()) {
        output::line(&format!("    self-test {}", describe_verdict(info, suite)));
    }
    let verdict = match info.missing() {
        missing if missing.is_empty() && fails(info) => "not used: fails its self-test".to_owned(),
        missing if missing.is_empty() => "usable".to_owned(),
        missing => format!("not usable: lacks {}", missing.join(", ")),
    };
    output::line(&format!("    => {verdict}"));
}
