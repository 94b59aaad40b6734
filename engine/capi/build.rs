//! Gives the shared library its soname: programs linked with `libspgs.so` ask for `libspgs.so.0` when they start.

fn main() {
    println!("cargo:rerun-if-changed=build.rs");
    if std::env::var("CARGO_CFG_TARGET_OS").is_ok_and(|os| os == "linux") {
        println!("cargo:rustc-cdylib-link-arg=-Wl,-soname,libspgs.so.0");
    }
}
