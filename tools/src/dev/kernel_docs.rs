//! `spgs-dev docs`: the kernels as a Markdown table, from their declarations.

use std::fmt::Write as _;

use engine::gpu::kernel::{Access, Kernel};

/// One row per kernel.
pub fn table() -> String {
    let mut text = String::from(
        "| kernel | what it does | threads | reads | writes | updates | constants | tolerance |\n|---|---|---|---|---|---|---|---|\n",
    );
    for kernel in engine::kernels() {
        let _ = writeln!(
            text,
            "| `{}` | {} | {} | {} | {} | {} | {} | {} |",
            kernel.name,
            kernel.doc,
            kernel.local_size,
            buffers(kernel, &[Access::Read]),
            buffers(kernel, &[Access::Write]),
            buffers(kernel, &[Access::Update, Access::Atomic]),
            kernel.spec.join(", "),
            tolerance(kernel)
        );
    }
    text
}

fn buffers(kernel: &Kernel, accesses: &[Access]) -> String {
    let names = kernel.bindings.iter().filter(|b| accesses.contains(&b.access));
    names
        .map(|b| if b.access == Access::Atomic { format!("{} (atomic)", b.name) } else { b.name.to_owned() })
        .collect::<Vec<_>>()
        .join(", ")
}

fn tolerance(kernel: &Kernel) -> String {
    let t = kernel.tolerance;
    if t.absolute == 0.0 && t.relative == 0.0 && t.flips == 0.0 {
        return "exact".into();
    }
    format!("{:e} + {:e}·x, {:e} flips", t.absolute, t.relative, t.flips)
}
