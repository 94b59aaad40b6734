//! What the model executes: operations on rows. A row holds one 32-bit value of each lane of a subgroup (a boolean is 0 or
//! 1). Vectors, arrays and structs are several rows, private variables rows that are written under the mask.

/// Number of a row.
pub(crate) type Row = u32;
/// No row: for an address without a dynamic part.
pub(crate) const NO_ROW: Row = u32::MAX;

/// Where a load, store or atomic goes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Space {
    /// Shared memory of the workgroup.
    Shared,
    /// Storage buffer of a binding.
    Buffer(u8),
}

/// `count` words from `base` + the value of row `at`.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Place {
    pub(crate) space: Space,
    pub(crate) count: u8,
    pub(crate) base: u32,
    pub(crate) at: Row,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Unary {
    Not,
    LogicalNot,
    Negate,
    NegateInt,
    BitCount,
    FloatOfUint,
    FloatOfInt,
    UintOfFloat,
    IntOfFloat,
    Sqrt,
    InverseSqrt,
    Exp,
    Exp2,
    Log,
    Log2,
    Sin,
    Cos,
    Floor,
    Ceil,
    Fract,
    Round,
    Trunc,
    Abs,
    AbsInt,
    Sign,
    LowestBit,
    HighestBit,
    IsNan,
    IsInf,
    HalfLow,
    HalfHigh,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Binary {
    Add,
    Subtract,
    Multiply,
    Divide,
    Remainder,
    AddInt,
    SubtractInt,
    MultiplyInt,
    DivideUint,
    RemainderUint,
    DivideInt,
    RemainderInt,
    And,
    Or,
    Xor,
    ShiftLeft,
    ShiftRight,
    ShiftRightInt,
    EqualInt,
    NotEqualInt,
    LessUint,
    LessEqualUint,
    LessInt,
    LessEqualInt,
    Equal,
    NotEqual,
    UnorderedNotEqual,
    Less,
    LessEqual,
    Min,
    Max,
    MinUint,
    MaxUint,
    MinInt,
    MaxInt,
    Pow,
    Atan2,
    PackHalf,
}

/// Arithmetic of subgroups.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Reduction {
    AddInt,
    Add,
    MinUint,
    MaxUint,
    Min,
    Max,
    And,
    Or,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Extent {
    Reduce,
    Inclusive,
    Exclusive,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Atomic {
    AddInt,
    Add,
    MinUint,
    MaxUint,
    And,
    Or,
    Xor,
    Exchange,
    CompareExchange,
    Load,
    Store,
}

/// Memory that a barrier orders.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(crate) struct Orders {
    pub(crate) shared: bool,
    pub(crate) storage: bool,
}

/// One operation. `d`: destination, `a`, `b`, `c`: sources, `f`: frame of the flow, `to`: where to go on with no lane active.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Op {
    Unary {
        op: Unary,
        d: Row,
        a: Row,
    },
    Binary {
        op: Binary,
        d: Row,
        a: Row,
        b: Row,
    },
    Select {
        d: Row,
        c: Row,
        a: Row,
        b: Row,
    },
    /// Under the mask.
    Move {
        d: Row,
        a: Row,
    },
    Copy {
        d: Row,
        a: Row,
    },
    Poison {
        first: Row,
        count: u32,
    },
    /// d = add + a * stride, saturating; `add` may be none.
    Index {
        d: Row,
        a: Row,
        stride: u32,
        add: Row,
    },
    /// The index in `a` must be below the limit; `name` is of what.
    Limit {
        a: Row,
        limit: u32,
        name: u32,
    },
    /// Row `base` + `at` of the lane.
    PrivateLoad {
        d: Row,
        base: Row,
        at: Row,
    },
    PrivateStore {
        a: Row,
        base: Row,
        at: Row,
    },
    Load {
        d: Row,
        place: Place,
    },
    Store {
        a: Row,
        place: Place,
    },
    Atomic {
        op: Atomic,
        d: Row,
        a: Row,
        b: Row,
        place: Place,
    },
    Image {
        binding: u8,
        at: [Row; 2],
        texel: Row,
    },
    Ballot {
        d: Row,
        a: Row,
    },
    Elect {
        d: Row,
    },
    Any {
        d: Row,
        a: Row,
    },
    All {
        d: Row,
        a: Row,
    },
    Shuffle {
        d: Row,
        a: Row,
        lane: Row,
    },
    ShuffleXor {
        d: Row,
        a: Row,
        mask: Row,
    },
    First {
        d: Row,
        a: Row,
    },
    Group {
        op: Reduction,
        extent: Extent,
        d: Row,
        a: Row,
    },
    Barrier {
        workgroup: bool,
        orders: Orders,
        number: u32,
    },
    /// Of the workgroup or wider: what the next barrier orders too.
    MemoryBarrier {
        orders: Orders,
    },
    If {
        f: u16,
        c: Row,
        to: u32,
    },
    Else {
        f: u16,
        to: u32,
    },
    EndIf {
        f: u16,
    },
    SkipIfEmpty {
        to: u32,
    },
    Loop {
        f: u16,
    },
    Break {
        f: u16,
    },
    /// Lanes leave where `c` is `when`.
    BreakIf {
        f: u16,
        c: Row,
        when: bool,
        to: u32,
    },
    Continue {
        f: u16,
    },
    LoopContinue {
        f: u16,
        to: u32,
    },
    LoopBack {
        to: u32,
    },
    LoopEnd {
        f: u16,
    },
    Call {
        f: u16,
    },
    Return {
        f: u16,
    },
    CallEnd {
        f: u16,
    },
    End,
}
