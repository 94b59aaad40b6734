//! Running this program on another driver, and what comes back.

use std::path::Path;
use std::process::{Command, Stdio};

use engine::error::{Error, Result};
use engine::gpu::Gpu;
use serde_json::{Value, json};

use super::statistics::{Row, Statistics};
use super::target::Target;

/// How targets are run.
#[derive(Debug, Clone, Copy)]
pub struct Run<'a> {
    /// This program.
    pub program: &'a Path,
    /// The script that knows the drivers.
    pub drivers: &'a Path,
}

/// What a target's compiler made.
#[derive(Debug, Clone)]
pub enum Collected {
    /// The driver is not there; with what the script says.
    Absent(String),
    /// Name and driver of the device, and every pipeline, by kernel and constants.
    Rows(String, Vec<Row>),
}

/// Sets the driver's environment, then becomes the program; status 77 when there is no such driver.
const SCRIPT: &str = r#"environment=$("$1" env "$2" "$3") || exit 77
eval "$environment"
export SPGS_SELF_TEST=0 SPGS_VALIDATION=0
unset SPGS_DEVICE
exec ${SPGS_RUNNER:-} "$4" isa --child "$5""#;
const ABSENT: i32 = 77;

/// All pipelines of a target.
///
/// # Errors
/// `Io` when the program cannot be started; `NoDevice` when it fails there or prints what it should not.
pub fn collect(target: &Target, run: Run<'_>) -> Result<Collected> {
    let output = Command::new("bash")
        .args(["-c", SCRIPT, "isa"])
        .args([run.drivers.as_os_str(), target.driver.as_ref(), target.gpu.as_ref(), run.program.as_os_str()])
        .arg(target.subgroup_size.to_string())
        .stdin(Stdio::null())
        .output()
        .map_err(|e| Error::io(Path::new("bash"), "run", e))?;
    let said = String::from_utf8_lossy(&output.stderr);
    if output.status.code() == Some(ABSENT) {
        return Ok(Collected::Absent(said.lines().next().unwrap_or("no reason given").to_owned()));
    }
    let fail = |why: String| Error::NoDevice { reason: format!("{}: {why}", target.name) };
    if !output.status.success() {
        return Err(fail(format!("{} on the driver; {}", output.status, said.trim())));
    }
    let printed = String::from_utf8_lossy(&output.stdout);
    let mut lines = printed.lines();
    let device: Option<Value> = lines.next().and_then(|l| serde_json::from_str(l).ok());
    let Some(device) = device.and_then(|d| d["device"].as_str().map(str::to_owned)) else {
        return Err(fail("no name of a device on its first line".to_owned()));
    };
    let row = |line: &str| serde_json::from_str(line).map_err(|e| fail(format!("`{line}`: {e}")));
    Ok(Collected::Rows(device, lines.map(row).collect::<Result<_>>()?))
}

/// What [`collect`] reads: a line for the device, then one per pipeline.
pub(super) fn lines(gpu: &Gpu) -> Result<Vec<String>> {
    let info = gpu.info();
    let mut lines = vec![json!({ "device": format!("{}, {}", info.name, info.driver) }).to_string()];
    for compiled in gpu.compiled_kernels()? {
        let (wanted, found) = (compiled.constants[0], compiled.subgroup_size);
        if wanted != found {
            let why = format!("specialised for subgroups of {wanted}, compiled for {found}");
            return Err(Error::Kernel { kernel: compiled.kernel.name.into(), why });
        }
        let row = Row {
            kernel: compiled.kernel.name.to_owned(),
            constants: compiled.constants[1..].to_vec(),
            statistics: Statistics::new(&compiled.statistics),
        };
        lines.push(json!(row).to_string());
    }
    Ok(lines)
}
