//! Kernels as types: what the host knows of a kernel when it is compiled.

use bytemuck::Pod;
use decouplegs_spirv::Interface;

use crate::{BoundMemory, Constant};

/// A kernel's module, and the types of what it takes. `make shaders` writes the implementations
/// from the SPIR-V, so that a buffer that is missing or holds other values does not compile.
pub trait Shader {
    /// Buffers, one member each, in the order of binding numbers.
    type Bindings<'a>;
    /// Push constants.
    type Push: Pod;
    /// Specialization constants.
    type Constants;

    /// Name of the source file, without its ending.
    const NAME: &'static str;
    /// Interface of the module.
    const INTERFACE: Interface;

    /// SPIR-V words of the module.
    fn spirv() -> &'static [u32];

    /// The buffers in the order of binding numbers.
    fn buffers<'a>(bindings: &Self::Bindings<'a>) -> impl AsRef<[BoundMemory<'a>]>;

    /// The constants in the order of their ids.
    fn values(constants: &Self::Constants) -> impl AsRef<[Constant]>;
}

/// Implements [`Shader`] for a kernel, with the types of what it takes, from a table of its
/// interface. The compiler of shaders writes such tables.
///
/// ```
/// # mod doubled {
/// #     decouplegs_gpu::shader! {
/// #         "doubled", &[];
/// #         entry_point: "main";
/// #         workgroup: [(64, None), (1, None), (1, None)];
/// #         capabilities: [1];
/// #         bindings {
/// #             0 values: f32, Read, None;
/// #             1 doubles: [f32; 2], Write, None;
/// #         }
/// #         push 0 {
/// #         }
/// #         constants {
/// #         }
/// #     }
/// # }
/// # use decouplegs_gpu::Buffer;
/// fn bind<'a>(values: &'a Buffer<f32>, doubles: &'a Buffer<[f32; 2]>) -> doubled::Bindings<'a> {
///     doubled::Bindings { values: values.bound(), doubles: doubles.bound() }
/// }
/// ```
///
/// Buffers that are swapped, or are not all there, do not compile:
///
/// ```compile_fail,E0308
/// # mod doubled {
/// #     decouplegs_gpu::shader! {
/// #         "doubled", &[];
/// #         entry_point: "main";
/// #         workgroup: [(64, None), (1, None), (1, None)];
/// #         capabilities: [1];
/// #         bindings {
/// #             0 values: f32, Read, None;
/// #             1 doubles: [f32; 2], Write, None;
/// #         }
/// #         push 0 {
/// #         }
/// #         constants {
/// #         }
/// #     }
/// # }
/// # use decouplegs_gpu::Buffer;
/// fn bind<'a>(values: &'a Buffer<f32>, doubles: &'a Buffer<[f32; 2]>) -> doubled::Bindings<'a> {
///     doubled::Bindings { values: doubles.bound(), doubles: values.bound() }
/// }
/// ```
///
/// ```compile_fail,E0063
/// # mod doubled {
/// #     decouplegs_gpu::shader! {
/// #         "doubled", &[];
/// #         entry_point: "main";
/// #         workgroup: [(64, None), (1, None), (1, None)];
/// #         capabilities: [1];
/// #         bindings {
/// #             0 values: f32, Read, None;
/// #             1 doubles: [f32; 2], Write, None;
/// #         }
/// #         push 0 {
/// #         }
/// #         constants {
/// #         }
/// #     }
/// # }
/// # use decouplegs_gpu::Buffer;
/// fn bind<'a>(values: &'a Buffer<f32>, doubles: &'a Buffer<[f32; 2]>) -> doubled::Bindings<'a> {
///     doubled::Bindings { values: values.bound() }
/// }
/// ```
#[macro_export]
macro_rules! shader {
    (
        $name:literal, $spirv:expr;
        entry_point: $entry_point:literal;
        workgroup: [$(($size:literal, $size_id:expr)),*];
        capabilities: [$($capability:literal),*];
        bindings { $($number:literal $buffer:ident: $held:ty, $access:ident, $uniform_bytes:expr;)* }
        push $push_bytes:literal { $($offset:literal $member:ident: $type:ty;)* }
        constants { $($id:literal $constant:ident $field:ident: $kind:ident;)* }
    ) => {
        #[doc = concat!("`", $name, ".comp`.")]
        pub struct Module;

        #[doc = concat!("Buffers of `", $name, ".comp`.")]
        pub struct Bindings<'a> {
            $(pub $buffer: $crate::Bound<'a, $held>,)*
        }

        #[doc = concat!("Push constants of `", $name, ".comp`.")]
        #[repr(C)]
        #[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
        pub struct Push {
            $(pub $member: $type,)*
        }

        $crate::same_layout! { Push, $push_bytes { $($offset $member: $type;)* } }

        #[doc = concat!("Specialization constants of `", $name, ".comp`.")]
        pub struct Constants {
            $(pub $field: $kind,)*
        }

        impl $crate::Shader for Module {
            type Bindings<'a> = Bindings<'a>;
            type Push = Push;
            type Constants = Constants;

            const NAME: &'static str = $name;
            const INTERFACE: $crate::Interface = $crate::Interface {
                entry_point: ::std::borrow::Cow::Borrowed($entry_point),
                workgroup: [$($crate::Size { value: $size, spec_id: $size_id }),*],
                capabilities: ::std::borrow::Cow::Borrowed(&[$($capability),*]),
                bindings: ::std::borrow::Cow::Borrowed(&[$($crate::Binding {
                    name: ::std::borrow::Cow::Borrowed(stringify!($buffer)),
                    number: $number,
                    access: $crate::Access::$access,
                    holds: ::std::borrow::Cow::Borrowed(stringify!($held)),
                    uniform_bytes: $uniform_bytes,
                }),*]),
                push: ::std::borrow::Cow::Borrowed(&[$($crate::Member {
                    name: ::std::borrow::Cow::Borrowed(stringify!($member)),
                    holds: ::std::borrow::Cow::Borrowed(stringify!($type)),
                    offset: $offset,
                }),*]),
                push_bytes: $push_bytes,
                constants: ::std::borrow::Cow::Borrowed(&[$($crate::SpecConstant {
                    name: ::std::borrow::Cow::Borrowed(stringify!($constant)),
                    spec_id: $id,
                    kind: $crate::shader!(@kind $kind),
                }),*]),
            };

            fn spirv() -> &'static [u32] {
                $spirv
            }

            fn buffers<'a>(
                bindings: &Self::Bindings<'a>,
            ) -> impl AsRef<[$crate::BoundMemory<'a>]> {
                [$(bindings.$buffer.memory()),*]
            }

            fn values(constants: &Constants) -> impl AsRef<[$crate::Constant]> {
                let Constants { $($field),* } = constants;
                [$($crate::shader!(@value $kind, *$field)),*]
            }
        }
    };
    (@kind bool) => { $crate::Kind::Bool };
    (@kind u32) => { $crate::Kind::U32 };
    (@kind i32) => { $crate::Kind::I32 };
    (@kind f32) => { $crate::Kind::F32 };
    (@value bool, $value:expr) => { $crate::Constant::Bool($value) };
    (@value u32, $value:expr) => { $crate::Constant::U32($value) };
    (@value i32, $value:expr) => { $crate::Constant::I32($value) };
    (@value f32, $value:expr) => { $crate::Constant::F32($value) };
}

/// Size of the member that `member` returns.
#[must_use]
pub const fn member_bytes<R, T>(_member: fn(&R) -> &T) -> usize {
    size_of::<T>()
}

/// Refuses to compile a structure that differs from the shaders': in its size, or in the offset or
/// size of a member.
///
/// ```
/// # #[repr(C)]
/// # struct Cluster { center_m: [f32; 3], radius_m: f32 }
/// decouplegs_gpu::same_layout! {
///     Cluster, 16 {
///         0 center_m: [f32; 3];
///         12 radius_m: f32;
///     }
/// }
/// ```
///
/// ```compile_fail,E0080
/// # #[repr(C)]
/// # struct Cluster { radius_m: f32, center_m: [f32; 3] }
/// decouplegs_gpu::same_layout! {
///     Cluster, 16 {
///         0 center_m: [f32; 3];
///         12 radius_m: f32;
///     }
/// }
/// ```
#[macro_export]
macro_rules! same_layout {
    ($record:ident, $bytes:literal { $($offset:literal $member:ident: $type:ty;)* }) => {
        const _: () = {
            assert!(
                ::std::mem::size_of::<$record>() == $bytes,
                concat!(stringify!($record), " has another size in the shaders")
            );
            $(
                assert!(
                    ::std::mem::offset_of!($record, $member) == $offset,
                    concat!(stringify!($record), ".", stringify!($member), " has another offset in the shaders")
                );
                assert!(
                    $crate::member_bytes(|record: &$record| &record.$member)
                        == ::std::mem::size_of::<$type>(),
                    concat!(stringify!($record), ".", stringify!($member), " has another size in the shaders")
                );
            )*
        };
    };
}
