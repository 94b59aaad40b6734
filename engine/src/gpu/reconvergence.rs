//! Asking a driver to let the lanes of a subgroup meet again where the source says that they do.
//!
//! Without it, where lanes meet after a condition is left to the compiler. Every kernel keeps its subgroup operations in flow
//! that is uniform anyway (`spgs-dev spirv --check` proves it), so this is a belt to those braces: it is asked for where the
//! device offers it, and nothing depends on it. The committed SPIR-V names no extension, so that every Vulkan 1.2 device can
//! read it; the request is written into the words that a device gets.

use serde::Serialize;

/// What a device promises about lanes that parted.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Reconvergence {
    /// Nothing.
    #[default]
    None,
    /// Subgroups that enter a construct together leave it together (`VK_KHR_shader_subgroup_uniform_control_flow`).
    SubgroupUniform,
    /// Lanes that part meet again as soon as the source lets them (`VK_KHR_shader_maximal_reconvergence`).
    Maximal,
}

const HEADER_WORDS: usize = 5;
const OP_EXTENSION: u32 = 10;
const OP_ENTRY_POINT: u32 = 15;
const OP_EXECUTION_MODE: u32 = 16;
const OP_CAPABILITY: u32 = 17;
const CAPABILITY_GROUP_NON_UNIFORM: u32 = 61;

impl Reconvergence {
    /// Extension and execution mode of the SPIR-V.
    fn request(self) -> Option<(&'static [u8], u32)> {
        match self {
            Self::None => None,
            Self::SubgroupUniform => Some((b"SPV_KHR_subgroup_uniform_control_flow", 4421)),
            Self::Maximal => Some((b"SPV_KHR_maximal_reconvergence", 6023)),
        }
    }

    /// The SPIR-V module with the request; unchanged when there is nothing to ask for or the module has no subgroup operations.
    pub fn ask(self, words: Vec<u32>) -> Vec<u32> {
        let (Some((extension, mode)), Some(places)) = (self.request(), places(&words)) else { return words };
        let mut asking = Vec::with_capacity(words.len() + 16);
        asking.extend_from_slice(&words[..places.extensions]);
        asking.extend(extension_instruction(extension));
        asking.extend_from_slice(&words[places.extensions..places.modes]);
        asking.extend([3 << 16 | OP_EXECUTION_MODE, places.entry_point, mode]);
        asking.extend_from_slice(&words[places.modes..]);
        asking
    }
}

/// Where the two instructions go, and the id that the second names.
struct Places {
    extensions: usize,
    modes: usize,
    entry_point: u32,
}

/// Of a module with subgroup operations: behind its capabilities and behind its entry point, where these sections go on.
fn places(words: &[u32]) -> Option<Places> {
    let (mut extensions, mut modes, mut entry_point) = (None, None, None);
    let mut has_subgroup_operations = false;
    let mut at = HEADER_WORDS;
    while at < words.len() && modes.is_none() {
        let (length, op) = ((words[at] >> 16) as usize, words[at] & 0xffff);
        let operands = words.get(at + 1..at + length)?;
        match (op, operands) {
            (OP_CAPABILITY, [capability]) => {
                has_subgroup_operations |= *capability == CAPABILITY_GROUP_NON_UNIFORM;
                extensions = Some(at + length);
            }
            (OP_ENTRY_POINT, [_, id, ..]) => (modes, entry_point) = (Some(at + length), Some(*id)),
            _ => {}
        }
        at += length;
    }
    has_subgroup_operations.then_some(Places { extensions: extensions?, modes: modes?, entry_point: entry_point? })
}

/// `OpExtension`; the name ends with at least one zero.
fn extension_instruction(name: &[u8]) -> Vec<u32> {
    let mut instruction = vec![0];
    for chunk in name.chunks(4) {
        let mut bytes = [0; 4];
        bytes[..chunk.len()].copy_from_slice(chunk);
        instruction.push(u32::from_le_bytes(bytes));
    }
    if name.len().is_multiple_of(4) {
        instruction.push(0);
    }
    instruction[0] = (instruction.len() as u32) << 16 | OP_EXTENSION;
    instruction
}
