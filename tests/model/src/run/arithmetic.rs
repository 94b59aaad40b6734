//! Arithmetic of whole rows. Lanes that are not active compute too: nothing here can fail, and what is undefined in SPIR-V
//! gives poison.

use half::f16;

use super::POISON;
use super::lanes::Lanes;
use crate::op::{Binary as B, Row, Unary as U};

fn f(x: u32) -> f32 {
    f32::from_bits(x)
}

#[inline]
fn map<const L: usize>(lanes: &mut Lanes<L>, d: Row, a: Row, op: impl Fn(u32) -> u32) {
    let a = lanes.row(a);
    let mut out = [0; L];
    for i in 0..L {
        out[i] = op(a[i]);
    }
    lanes.set(d, out);
}

#[inline]
fn map_float<const L: usize>(lanes: &mut Lanes<L>, d: Row, a: Row, op: impl Fn(f32) -> f32) {
    map(lanes, d, a, |x| op(f(x)).to_bits());
}

#[inline]
fn zip<const L: usize>(lanes: &mut Lanes<L>, d: Row, a: Row, b: Row, op: impl Fn(u32, u32) -> u32) {
    let (a, b) = (lanes.row(a), lanes.row(b));
    let mut out = [0; L];
    for i in 0..L {
        out[i] = op(a[i], b[i]);
    }
    lanes.set(d, out);
}

#[inline]
fn zip_float<const L: usize>(lanes: &mut Lanes<L>, d: Row, a: Row, b: Row, op: impl Fn(f32, f32) -> f32) {
    zip(lanes, d, a, b, |x, y| op(f(x), f(y)).to_bits());
}

#[inline]
fn compare<const L: usize>(lanes: &mut Lanes<L>, d: Row, a: Row, b: Row, op: impl Fn(f32, f32) -> bool) {
    zip(lanes, d, a, b, |x, y| u32::from(op(f(x), f(y))));
}

fn sign(x: f32) -> f32 {
    if x > 0.0 {
        1.0
    } else if x < 0.0 {
        -1.0
    } else {
        0.0
    }
}

pub(super) fn unary<const L: usize>(lanes: &mut Lanes<L>, op: U, d: Row, a: Row) {
    match op {
        U::Not => map(lanes, d, a, |x| !x),
        U::LogicalNot => map(lanes, d, a, |x| u32::from(x == 0)),
        U::Negate => map(lanes, d, a, |x| x ^ 0x8000_0000),
        U::NegateInt => map(lanes, d, a, u32::wrapping_neg),
        U::BitCount => map(lanes, d, a, u32::count_ones),
        U::FloatOfUint => map(lanes, d, a, |x| (x as f32).to_bits()),
        U::FloatOfInt => map(lanes, d, a, |x| (x as i32 as f32).to_bits()),
        U::UintOfFloat => map(lanes, d, a, |x| f(x) as u32),
        U::IntOfFloat => map(lanes, d, a, |x| f(x) as i32 as u32),
        U::Sqrt => map_float(lanes, d, a, f32::sqrt),
        U::InverseSqrt => map_float(lanes, d, a, |x| 1.0 / x.sqrt()),
        U::Exp => map_float(lanes, d, a, f32::exp),
        U::Exp2 => map_float(lanes, d, a, f32::exp2),
        U::Log => map_float(lanes, d, a, f32::ln),
        U::Log2 => map_float(lanes, d, a, f32::log2),
        U::Sin => map_float(lanes, d, a, f32::sin),
        U::Cos => map_float(lanes, d, a, f32::cos),
        U::Floor => map_float(lanes, d, a, f32::floor),
        U::Ceil => map_float(lanes, d, a, f32::ceil),
        U::Fract => map_float(lanes, d, a, |x| x - x.floor()),
        U::Round => map_float(lanes, d, a, f32::round_ties_even),
        U::Trunc => map_float(lanes, d, a, f32::trunc),
        U::Abs => map(lanes, d, a, |x| x & 0x7FFF_FFFF),
        U::AbsInt => map(lanes, d, a, |x| (x as i32).wrapping_abs() as u32),
        U::Sign => map_float(lanes, d, a, sign),
        U::LowestBit => map(lanes, d, a, |x| if x == 0 { u32::MAX } else { x.trailing_zeros() }),
        U::HighestBit => map(lanes, d, a, |x| if x == 0 { u32::MAX } else { 31 - x.leading_zeros() }),
        U::IsNan => map(lanes, d, a, |x| u32::from(f(x).is_nan())),
        U::IsInf => map(lanes, d, a, |x| u32::from(f(x).is_infinite())),
        U::HalfLow => map(lanes, d, a, |x| f16::from_bits(x as u16).to_f32().to_bits()),
        U::HalfHigh => map(lanes, d, a, |x| f16::from_bits((x >> 16) as u16).to_f32().to_bits()),
    }
}

fn signed(op: impl Fn(i32, i32) -> i32) -> impl Fn(u32, u32) -> u32 {
    move |x, y| op(x as i32, y as i32) as u32
}

pub(super) fn binary<const L: usize>(lanes: &mut Lanes<L>, op: B, d: Row, a: Row, b: Row) {
    match op {
        B::Add => zip_float(lanes, d, a, b, |x, y| x + y),
        B::Subtract => zip_float(lanes, d, a, b, |x, y| x - y),
        B::Multiply => zip_float(lanes, d, a, b, |x, y| x * y),
        B::Divide => zip_float(lanes, d, a, b, |x, y| x / y),
        B::Remainder => zip_float(lanes, d, a, b, |x, y| x - y * (x / y).floor()),
        B::Min => zip_float(lanes, d, a, b, f32::min),
        B::Max => zip_float(lanes, d, a, b, f32::max),
        B::Pow => zip_float(lanes, d, a, b, f32::powf),
        B::Atan2 => zip_float(lanes, d, a, b, f32::atan2),
        B::Equal => compare(lanes, d, a, b, |x, y| x == y),
        B::NotEqual => compare(lanes, d, a, b, |x, y| x != y && !x.is_nan() && !y.is_nan()),
        B::UnorderedNotEqual => compare(lanes, d, a, b, |x, y| x != y),
        B::Less => compare(lanes, d, a, b, |x, y| x < y),
        B::LessEqual => compare(lanes, d, a, b, |x, y| x <= y),
        B::PackHalf => zip(lanes, d, a, b, |x, y| {
            u32::from(f16::from_f32(f(x)).to_bits()) | (u32::from(f16::from_f32(f(y)).to_bits()) << 16)
        }),
        _ => binary_int(lanes, op, d, a, b),
    }
}

fn binary_int<const L: usize>(lanes: &mut Lanes<L>, op: B, d: Row, a: Row, b: Row) {
    match op {
        B::AddInt => zip(lanes, d, a, b, u32::wrapping_add),
        B::SubtractInt => zip(lanes, d, a, b, u32::wrapping_sub),
        B::MultiplyInt => zip(lanes, d, a, b, u32::wrapping_mul),
        B::DivideUint => zip(lanes, d, a, b, |x, y| x.checked_div(y).unwrap_or(POISON)),
        B::RemainderUint => zip(lanes, d, a, b, |x, y| x.checked_rem(y).unwrap_or(POISON)),
        B::DivideInt => zip(lanes, d, a, b, signed(|x, y| x.checked_div(y).unwrap_or(POISON as i32))),
        B::RemainderInt => zip(lanes, d, a, b, signed(|x, y| x.checked_rem(y).unwrap_or(POISON as i32))),
        B::And => zip(lanes, d, a, b, |x, y| x & y),
        B::Or => zip(lanes, d, a, b, |x, y| x | y),
        B::Xor => zip(lanes, d, a, b, |x, y| x ^ y),
        B::ShiftLeft => zip(lanes, d, a, b, |x, y| x.checked_shl(y).unwrap_or(POISON)),
        B::ShiftRight => zip(lanes, d, a, b, |x, y| x.checked_shr(y).unwrap_or(POISON)),
        B::ShiftRightInt => zip(lanes, d, a, b, |x, y| (x as i32).checked_shr(y).map_or(POISON, |v| v as u32)),
        B::EqualInt => zip(lanes, d, a, b, |x, y| u32::from(x == y)),
        B::NotEqualInt => zip(lanes, d, a, b, |x, y| u32::from(x != y)),
        B::LessUint => zip(lanes, d, a, b, |x, y| u32::from(x < y)),
        B::LessEqualUint => zip(lanes, d, a, b, |x, y| u32::from(x <= y)),
        B::LessInt => zip(lanes, d, a, b, |x, y| u32::from((x as i32) < y as i32)),
        B::LessEqualInt => zip(lanes, d, a, b, |x, y| u32::from(x as i32 <= y as i32)),
        B::MinUint => zip(lanes, d, a, b, u32::min),
        B::MaxUint => zip(lanes, d, a, b, u32::max),
        B::MinInt => zip(lanes, d, a, b, signed(i32::min)),
        B::MaxInt => zip(lanes, d, a, b, signed(i32::max)),
        _ => {}
    }
}
