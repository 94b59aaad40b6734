//! Which queue family the engine works on.
//!
//! Kernels alone go to a family that computes and does not draw, where there is one: what the desktop draws then has a queue
//! of its own, so that a long kernel does not hold it up, and drivers give such a queue more time before they call it hung
//! (amdgpu: 60 s for 10). A window needs a family that draws too, for the interface over the picture. A family whose
//! timestamps have no valid bits is taken only when all are so.

use ash::vk;
use serde::Serialize;

/// What the engine looks at in a queue family.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct QueueFamily {
    /// `VK_QUEUE_COMPUTE_BIT`.
    pub compute: bool,
    /// `VK_QUEUE_GRAPHICS_BIT`.
    pub graphics: bool,
    /// `timestampValidBits`: 0, or 36 to 64.
    pub timestamp_bits: u32,
}

impl QueueFamily {
    pub(super) fn of(properties: &vk::QueueFamilyProperties) -> Self {
        Self {
            compute: properties.queue_flags.contains(vk::QueueFlags::COMPUTE),
            graphics: properties.queue_flags.contains(vk::QueueFlags::GRAPHICS),
            timestamp_bits: properties.timestamp_valid_bits,
        }
    }
}

/// The index of the family to work on; `draws`: it must draw too. `None`: there is none.
pub fn choose(families: &[QueueFamily], draws: bool) -> Option<u32> {
    let usable = families.iter().enumerate().filter(|(_, f)| f.compute && (f.graphics || !draws));
    usable.min_by_key(|(_, f)| (f.timestamp_bits == 0, f.graphics && !draws)).map(|(index, _)| index as u32)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn family(flags: &str, timestamp_bits: u32) -> QueueFamily {
        QueueFamily { compute: flags.contains('c'), graphics: flags.contains('g'), timestamp_bits }
    }

    #[test]
    fn kernels_alone_leave_the_drawing_queue_to_the_desktop() {
        // Of an AMD card (graphics, compute, copies, video), an NVIDIA card, an Intel one with a compute engine, lavapipe.
        let cases = [
            (vec![family("gc", 64), family("c", 64), family("", 64), family("", 0)], [Some(1), Some(0)]),
            (vec![family("gc", 64), family("", 64), family("c", 64), family("", 32)], [Some(2), Some(0)]),
            (vec![family("gc", 36), family("c", 36)], [Some(1), Some(0)]),
            (vec![family("gc", 64)], [Some(0), Some(0)]),
            (vec![family("g", 64), family("c", 64)], [Some(1), None]),
            (vec![family("g", 64), family("", 64)], [None, None]),
            (vec![], [None, None]),
        ];
        for (families, expected) in cases {
            assert_eq!([false, true].map(|draws| choose(&families, draws)), expected, "{families:?}");
        }
    }

    #[test]
    fn a_family_with_timestamps_comes_first_and_the_first_of_equals() {
        assert_eq!(choose(&[family("gc", 64), family("c", 0)], false), Some(0));
        assert_eq!(choose(&[family("gc", 0), family("c", 0)], false), Some(1));
        assert_eq!(choose(&[family("gc", 0), family("gc", 48)], true), Some(1));
        assert_eq!(choose(&[family("gc", 64), family("c", 64), family("c", 64)], false), Some(1));
    }
}
