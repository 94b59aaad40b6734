//! What a kernel is given, by name: its buffers, specialisation constants and push constants as fields of structs that the
//! dispatch, the twin and the tests share. The order of a struct's fields is the order in the GLSL, checked against the
//! SPIR-V; nobody else writes it down.
//!
//! [`gpu_struct!`](crate::gpu_struct), [`gpu_constants!`](crate::gpu_constants) and [`gpu_buffers!`](crate::gpu_buffers)
//! declare the parts, [`kernel!`](crate::kernel) puts them together.

use std::ops::Deref;

use super::kernel::{Binding, Field, Kernel, TwinCall};

/// A plain-data struct shared with GLSL. Made by [`gpu_struct!`](crate::gpu_struct); `()` for none.
pub trait GpuStruct: bytemuck::Pod {
    /// Name and byte offset of each member, checked against the SPIR-V.
    const MEMBERS: &'static [Field];
}

impl GpuStruct for () {
    const MEMBERS: &'static [Field] = &[];
}

/// Specialisation constants from id 1 on, all u32. Made by [`gpu_constants!`](crate::gpu_constants); `()` for none.
pub trait Constants: Copy {
    /// Names in the GLSL, `SUBGROUP_SIZE` first.
    const NAMES: &'static [&'static str];

    /// Their values from id 1 on.
    fn to_words(self) -> Vec<u32>;

    /// From values as `to_words` gives them; what is missing is 0.
    fn of_words(words: &[u32]) -> Self;
}

impl Constants for () {
    const NAMES: &'static [&'static str] = &["SUBGROUP_SIZE"];

    fn to_words(self) -> Vec<u32> {
        Vec::new()
    }

    fn of_words(_: &[u32]) -> Self {}
}

/// A kernel's buffers, one field each: `T` is a [`Slice`](super::Slice) for a dispatch, words for a twin or a test. Made by
/// [`gpu_buffers!`](crate::gpu_buffers).
pub trait Buffers<T>: Sized {
    /// In binding order.
    const BINDINGS: &'static [Binding];

    /// In binding order; `None` where an optional one is absent.
    fn into_list(self) -> Vec<Option<T>>;

    /// Makes each by its binding's index; an optional one only if it is `present`.
    fn from_fn(present: impl Fn(usize) -> bool, make: impl FnMut(usize) -> T) -> Self;
}

/// What a kernel is given. Made by [`kernel!`](crate::kernel).
pub trait Interface: 'static {
    /// Specialisation constants.
    type Constants: Constants;
    /// Push constants.
    type Push: GpuStruct;
    /// Buffers.
    type Buffers<T>: Buffers<T>;
}

/// A kernel that knows what it is given.
#[derive(Debug)]
pub struct KernelOf<I: Interface> {
    /// The kernel without its types, for lists of kernels.
    pub kernel: Kernel,
    interface: std::marker::PhantomData<fn() -> I>,
}

impl<I: Interface> KernelOf<I> {
    /// Ties a kernel to its interface; only [`kernel!`](crate::kernel) calls it.
    #[doc(hidden)]
    pub const fn new(kernel: Kernel) -> Self {
        Self { kernel, interface: std::marker::PhantomData }
    }

    /// What the twin makes of these buffers.
    pub fn run_twin(
        &self,
        subgroup_size: u32,
        constants: I::Constants,
        push: I::Push,
        buffers: I::Buffers<Vec<u32>>,
        groups: u32,
    ) -> I::Buffers<Vec<u32>> {
        let spec = [&[subgroup_size], &constants.to_words()[..]].concat();
        let mut buffers = into_words::<I>(buffers);
        let push = bytemuck::bytes_of(&push);
        (self.twin)(&mut TwinCall { groups: [groups, 1, 1], spec: &spec, push, buffers: &mut buffers });
        of_words::<I>(buffers)
    }
}

/// Words of each buffer in binding order; none of an absent one.
pub(super) fn into_words<I: Interface>(buffers: I::Buffers<Vec<u32>>) -> Vec<Vec<u32>> {
    buffers.into_list().into_iter().map(Option::unwrap_or_default).collect()
}

/// The buffers by name; an optional one without words is absent.
pub fn of_words<I: Interface>(mut words: Vec<Vec<u32>>) -> I::Buffers<Vec<u32>> {
    let present: Vec<bool> = words.iter().map(|words| !words.is_empty()).collect();
    let take = |i: usize| words.get_mut(i).map(std::mem::take).unwrap_or_default();
    I::Buffers::from_fn(|i| present.get(i).copied().unwrap_or(false), take)
}

impl<I: Interface> Deref for KernelOf<I> {
    type Target = Kernel;
    fn deref(&self) -> &Kernel {
        &self.kernel
    }
}

/// What a twin is given.
#[derive(Debug)]
pub struct Call<'a, I: Interface> {
    /// Workgroups in x, y, z.
    pub groups: [u32; 3],
    /// Invocations of a subgroup.
    pub subgroup_size: u32,
    /// Specialisation constants.
    pub constants: I::Constants,
    /// Push constants.
    pub push: I::Push,
    /// 32-bit words of each buffer, as the GPU sees them.
    pub buffers: I::Buffers<&'a mut [u32]>,
    /// Words of the image that the kernel stores to, tightly packed; empty if it stores to none.
    pub image: &'a mut [u32],
}

impl<'a, I: Interface> Call<'a, I> {
    /// The call of a twin by name. An optional buffer without words is absent.
    pub fn of(call: &'a mut TwinCall<'_>) -> Self {
        let bindings = <I::Buffers<()> as Buffers<()>>::BINDINGS.len().min(call.buffers.len());
        let (buffers, image) = call.buffers.split_at_mut(bindings);
        let present: Vec<bool> = buffers.iter().map(|words| !words.is_empty()).collect();
        let mut words: Vec<Option<&'a mut [u32]>> =
            buffers.iter_mut().map(|words| Some(words.as_mut_slice())).collect();
        let mut take = |i: usize| words.get_mut(i).and_then(Option::take).unwrap_or_default();
        Self {
            groups: call.groups,
            subgroup_size: call.spec.first().copied().unwrap_or(0),
            constants: I::Constants::of_words(call.spec.get(1..).unwrap_or_default()),
            push: bytemuck::pod_read_unaligned(&call.push[..size_of::<I::Push>()]),
            buffers: I::Buffers::from_fn(|i| present.get(i).copied().unwrap_or(false), &mut take),
            image: image.first_mut().map(Vec::as_mut_slice).unwrap_or_default(),
        }
    }

    /// Workgroups of a folded one-dimensional grid (`glsl/lib/dispatch.glsl`).
    pub fn group_count(&self) -> u32 {
        self.groups.iter().product()
    }
}

/// Capital letters of an ASCII name, at compile time.
#[doc(hidden)]
pub const fn capitals<const N: usize>(name: &str) -> [u8; N] {
    let (mut out, mut i) = ([0; N], 0);
    while i < N {
        out[i] = name.as_bytes()[i].to_ascii_uppercase();
        i += 1;
    }
    out
}

/// `bindings`, then an image named `image`, at compile time.
#[doc(hidden)]
pub const fn with_image<const N: usize>(bindings: &[Binding], image: &'static str) -> [Binding; N] {
    let binding = Binding::new(image, super::kernel::Access::Write, super::kernel::Element::Image);
    let (mut out, mut i) = ([binding; N], 0);
    while i < bindings.len() {
        out[i] = bindings[i];
        i += 1;
    }
    out
}

/// Declares a `#[repr(C)]` plain-data struct shared with GLSL, with its member table.
#[macro_export]
macro_rules! gpu_struct {
    ($(#[$meta:meta])* pub struct $name:ident { $($(#[$fmeta:meta])* pub $field:ident : $ty:ty),* $(,)? }) => {
        $(#[$meta])*
        #[repr(C)]
        #[derive(Debug, Clone, Copy, Default, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
        pub struct $name { $($(#[$fmeta])* pub $field: $ty),* }
        impl $crate::gpu::interface::GpuStruct for $name {
            const MEMBERS: &'static [$crate::gpu::kernel::Field] =
                &[$((stringify!($field), std::mem::offset_of!($name, $field) as u32)),*];
        }
    };
}

/// Declares a kernel's specialisation constants, from id 1 on: a field `has_values` is `HAS_VALUES` in the GLSL.
#[macro_export]
macro_rules! gpu_constants {
    ($(#[$meta:meta])* pub struct $name:ident { $($(#[$fmeta:meta])* $field:ident),* $(,)? }) => {
        $(#[$meta])*
        #[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
        pub struct $name { $($(#[$fmeta])* pub $field: u32),* }
        impl $crate::gpu::interface::Constants for $name {
            const NAMES: &'static [&'static str] = &["SUBGROUP_SIZE", $({
                const CAPITALS: [u8; stringify!($field).len()] =
                    $crate::gpu::interface::capitals(stringify!($field));
                match std::str::from_utf8(&CAPITALS) {
                    Ok(name) => name,
                    Err(_) => "",
                }
            }),*];

            fn to_words(self) -> Vec<u32> {
                vec![$(self.$field),*]
            }

            fn of_words(words: &[u32]) -> Self {
                let mut words = words.iter().copied();
                Self { $($field: words.next().unwrap_or(0)),* }
            }
        }
    };
}

/// Declares a kernel's buffers in binding order: `mean: Read F32`, `frame: Read Struct(Frame)`, `pose: optional Read F32`.
#[macro_export]
macro_rules! gpu_buffers {
    (@type $T:ident optional $($rest:tt)*) => { Option<$T> };
    (@type $T:ident $($rest:tt)*) => { $T };

    (@binding $name:ident optional $($rest:tt)*) => {
        $crate::gpu_buffers!(@binding $name $($rest)*).optional()
    };
    (@binding $name:ident $access:ident Struct($ty:ty)) => {
        $crate::gpu::kernel::Binding::of_struct(
            stringify!($name),
            $crate::gpu::kernel::Access::$access,
            <$ty as $crate::gpu::interface::GpuStruct>::MEMBERS,
        )
    };
    (@binding $name:ident $access:ident $element:ident) => {
        $crate::gpu::kernel::Binding::new(
            stringify!($name),
            $crate::gpu::kernel::Access::$access,
            $crate::gpu::kernel::Element::$element,
        )
    };

    (@list $value:expr; optional $($rest:tt)*) => { $value };
    (@list $value:expr; $($rest:tt)*) => { Some($value) };

    (@make $present:ident $make:ident $i:ident; optional $($rest:tt)*) => { $present($i).then(|| $make($i)) };
    (@make $present:ident $make:ident $i:ident; $($rest:tt)*) => { $make($i) };

    ($(#[$meta:meta])* pub struct $name:ident {
        $($(#[$fmeta:meta])* $field:ident : $($word:ident)+ $(($ty:ty))?),* $(,)?
    }) => {
        $(#[$meta])*
        pub struct $name<T> {
            $(
                $(#[$fmeta])*
                #[doc = concat!("`", $(stringify!($word), " ",)+ $(stringify!($ty), " ",)? "`")]
                pub $field: $crate::gpu_buffers!(@type T $($word)+)
            ),*
        }
        // Not derived: a derive does not see through the macro in a field's type.
        impl<T: Clone> Clone for $name<T> {
            fn clone(&self) -> Self {
                Self { $($field: self.$field.clone()),* }
            }
        }
        impl<T: std::fmt::Debug> std::fmt::Debug for $name<T> {
            fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                f.debug_struct(stringify!($name))$(.field(stringify!($field), &self.$field))*.finish()
            }
        }
        impl<T> $crate::gpu::interface::Buffers<T> for $name<T> {
            const BINDINGS: &'static [$crate::gpu::kernel::Binding] =
                &[$($crate::gpu_buffers!(@binding $field $($word)+ $(($ty))?)),*];

            fn into_list(self) -> Vec<Option<T>> {
                vec![$($crate::gpu_buffers!(@list self.$field; $($word)+)),*]
            }

            #[allow(unused_assignments, reason = "the count after the last field")]
            fn from_fn(present: impl Fn(usize) -> bool, mut make: impl FnMut(usize) -> T) -> Self {
                let _ = &present;
                let mut next = 0;
                $(
                    let i = next;
                    next += 1;
                    let $field = $crate::gpu_buffers!(@make present make i; $($word)+);
                )*
                Self { $($field),* }
            }
        }
    };
}

/// Declares a kernel once: pipeline, dispatch, barriers, twin and tests follow from it. `glsl/**/NAME.comp` is its source;
/// `image`, if it stores to one, names it, after the buffers; `arrange` is for one that leaves things in any order.
#[macro_export]
macro_rules! kernel {
    ($(#[$meta:meta])* pub static $KERNEL:ident: $interface:ident = {
        name: $name:literal,
        doc: $doc:literal,
        local_size: $local_size:expr,
        constants: $constants:ty,
        push: $push:ty,
        buffers: $buffers:ident,
        $(image: $image:literal,)?
        twin: $twin:expr,
        $(arrange: $arrange:expr,)?
        tolerance: $tolerance:expr,
        bytes: $bytes:expr $(,)?
    }) => {
        #[doc = concat!("What [`", stringify!($KERNEL), "`] is given.")]
        #[doc(hidden)]
        #[derive(Debug, Clone, Copy)]
        pub struct $interface;
        impl $crate::gpu::interface::Interface for $interface {
            type Constants = $constants;
            type Push = $push;
            type Buffers<T> = $buffers<T>;
        }
        $(#[$meta])*
        pub static $KERNEL: $crate::gpu::interface::KernelOf<$interface> =
            $crate::gpu::interface::KernelOf::new($crate::gpu::kernel::Kernel {
                name: $name,
                doc: $doc,
                local_size: $local_size,
                spec: <$constants as $crate::gpu::interface::Constants>::NAMES,
                push: <$push as $crate::gpu::interface::GpuStruct>::MEMBERS,
                bindings: $crate::kernel!(@bindings $buffers $($image)?),
                twin: |call| {
                    let twin: fn($crate::gpu::interface::Call<'_, $interface>) = $twin;
                    twin($crate::gpu::interface::Call::of(call))
                },
                arrange: $crate::kernel!(@arrange $($arrange)?),
                tolerance: $tolerance,
                bytes: $bytes,
                spirv: include_bytes!(concat!(env!("CARGO_MANIFEST_DIR"), "/../spirv_cache/", $name, ".spv")),
            });
    };
    (@arrange) => { None };
    (@arrange $arrange:expr) => { Some($arrange) };
    (@bindings $buffers:ident) => { <$buffers<()> as $crate::gpu::interface::Buffers<()>>::BINDINGS };
    (@bindings $buffers:ident $image:literal) => {{
        const BUFFERS: &[$crate::gpu::kernel::Binding] = <$buffers<()> as $crate::gpu::interface::Buffers<()>>::BINDINGS;
        const ALL: [$crate::gpu::kernel::Binding; BUFFERS.len() + 1] =
            $crate::gpu::interface::with_image(BUFFERS, $image);
        &ALL
    }};
}
