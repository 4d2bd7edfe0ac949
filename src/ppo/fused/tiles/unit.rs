/*! The tile unit of x86-64 (AMX): products of bf16 operands, summed in f32.

Eight tile registers hold 16 rows of 64 bytes each. One instruction adds the product of two tiles to a third:
16 × 32 bf16 times 32 × 16 bf16 gives 16 × 16 f32. The right operand holds in row `j` of column `n` the pair of its rows
`k`, the left one in row `m` the pairs of its columns. Any pairing works if both operands agree; here `k` is paired with
`k + 16`, so that two vectors make a row of pairs by a shift and a mask.

Denormal numbers count as zero, on the way in and out.
*/

#![allow(unsafe_code)]

use std::arch::asm;
use std::arch::x86_64::{__cpuid_count, _MM_HINT_T1, _mm_prefetch};
use std::cell::Cell;
use std::marker::PhantomData;
use std::sync::OnceLock;

use pulp::u32x16;
use pulp::x86::V4;

/// A tile: 16 rows of 16 pairs of bf16.
#[derive(Debug, Clone, Copy)]
#[repr(C, align(64))]
pub struct Tile(pub [u32x16; 16]);

/// An operand: 32 × 32 numbers of a product's left or right side, each as the sum of `PARTS` bf16 numbers: the first is
/// the rounded number, the second the rest. The two tiles of a part are rows 0–15 and 16–31 of a left operand, columns
/// 0–15 and 16–31 of a right one.
#[derive(Debug, Clone, Copy)]
#[repr(C)]
pub struct Operand<const PARTS: usize>(pub [[Tile; 2]; PARTS]);

impl<const PARTS: usize> Operand<PARTS> {
    /// An operand of zeros.
    pub const ZERO: Self = Self([[Tile([u32x16(0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0); 16]); 2]; PARTS]);
}

/// 32 × 32 sums, as four tiles of 16 × 16, row by row: upper left, upper right, lower left, lower right.
pub type Square = [f32; SQUARE];

/// Number of elements in a [`Square`].
pub const SQUARE: usize = 32 * 32;

/// The tile unit of this thread, configured for products.
pub struct TileUnit {
    pub simd: V4,
    /// Addresses of the two operands of each step of a product.
    steps: Vec<[*const Tile; 2]>,
    /// Marker that keeps the value on its thread, because every thread has its own unit.
    thread: PhantomData<*const ()>,
}

thread_local! {
    /// Number of [`TileUnit`] values on this thread; dropping the last one releases the registers.
    static UNITS: Cell<usize> = const { Cell::new(0) };
}

/// A tile configuration for the instruction `ldtilecfg`.
#[repr(C, align(64))]
struct Shapes {
    palette: u8,
    start_row: u8,
    reserved: [u8; 14],
    bytes_per_row: [u16; 16],
    rows: [u8; 16],
}

/// The configuration of eight tiles with 16 rows of 64 bytes.
static SHAPES: Shapes = {
    let (mut bytes_per_row, mut rows, mut tile) = ([0; 16], [0; 16], 0);
    while tile < 8 {
        (bytes_per_row[tile], rows[tile]) = (64, 16);
        tile += 1;
    }
    Shapes { palette: 1, start_row: 0, reserved: [0; 14], bytes_per_row, rows }
};

/// Returns true if the processor has tile units and Linux lets this process use them.
pub fn available() -> bool {
    static AVAILABLE: OnceLock<bool> = OnceLock::new();
    *AVAILABLE.get_or_init(|| {
        const AMX_BF16: u32 = 1 << 22;
        const AMX_TILE: u32 = 1 << 24;
        let needed = AMX_BF16 | AMX_TILE;
        __cpuid_count(7, 0).edx & needed == needed && V4::try_new().is_some() && permitted()
    })
}

/// Asks Linux for the tile registers, which it saves only for processes that request them.
fn permitted() -> bool {
    const ARCH_PRCTL: i64 = 158;
    const ARCH_REQ_XCOMP_PERM: u64 = 0x1023;
    const XFEATURE_XTILEDATA: u64 = 18;
    let mut answer = ARCH_PRCTL;
    // SAFETY: a system call that takes two numbers, touches no memory of ours and clobbers the registers named.
    unsafe {
        asm!(
            "syscall", inlateout("rax") answer, in("rdi") ARCH_REQ_XCOMP_PERM, in("rsi") XFEATURE_XTILEDATA,
            lateout("rcx") _, lateout("r11") _, options(nostack),
        );
    }
    answer == 0
}

/// Sums the products of all steps. It is one block of assembly, because Rust does not promise that tile registers keep
/// their content between two. The instructions of a step find its left operand at `a`, its right one at `b`, the length of
/// a tile's row in `row`, and the sums in tiles 0 to 3.
macro_rules! sum_products {
    ($steps:ident, $sums:ident, $add:ident, $($of_step:literal),+) => {
        // SAFETY: `sums` is four tiles of 1024 bytes, an operand two for each part, which are only read. A step is two addresses. A
        // `TileUnit` exists only where the instructions do.
        unsafe {
            asm!(
                "tilezero tmm0", "tilezero tmm1", "tilezero tmm2", "tilezero tmm3",
                "test {add}, {add}",
                "jz 2f",
                "tileloadd tmm0, [{c} + {row}]",
                "tileloadd tmm1, [{c} + {row} + 1024]",
                "tileloadd tmm2, [{c} + {row} + 2048]",
                "tileloadd tmm3, [{c} + {row} + 3072]",
                "2:",
                "cmp {step}, {end}",
                "je 3f",
                "mov {a}, [{step}]",
                "mov {b}, [{step} + 8]",
                "add {step}, 16",
                $($of_step,)+
                "jmp 2b",
                "3:",
                "tilestored [{c} + {row}], tmm0",
                "tilestored [{c} + {row} + 1024], tmm1",
                "tilestored [{c} + {row} + 2048], tmm2",
                "tilestored [{c} + {row} + 3072], tmm3",
                c = in(reg) $sums.as_mut_ptr(), row = in(reg) 64_usize, add = in(reg) usize::from($add),
                step = inout(reg) $steps.as_ptr() => _, end = in(reg) $steps.as_ptr_range().end,
                a = out(reg) _, b = out(reg) _,
                out("tmm0") _, out("tmm1") _, out("tmm2") _, out("tmm3") _,
                out("tmm4") _, out("tmm5") _, out("tmm6") _, out("tmm7") _,
                options(nostack),
            );
        }
    };
}

impl TileUnit {
    /// Configures the tile unit of this thread; `None` if there is none.
    pub fn new() -> Option<Self> {
        let simd = V4::try_new().filter(|_| available())?;
        // SAFETY: the processor has the instruction and Linux permits it; it reads 64 bytes.
        unsafe { asm!("ldtilecfg [{0}]", in(reg) &raw const SHAPES, options(nostack, preserves_flags, readonly)) };
        UNITS.set(UNITS.get() + 1);
        Some(Self { simd, steps: Vec::new(), thread: PhantomData })
    }

    /// Computes `sums = Σ left · right`, or adds to `sums`. With two parts the product of the two small ones, 2⁻¹⁶ of the
    /// whole, is omitted.
    #[inline(always)]
    pub fn product<'a, const PARTS: usize>(
        &mut self,
        steps: impl Iterator<Item = (&'a Operand<PARTS>, &'a Operand<PARTS>)>,
        sums: &mut Square,
        add: bool,
    ) {
        const { assert!(PARTS == 1 || PARTS == 2) };
        self.steps.clear();
        self.steps.extend(steps.map(|(left, right)| [left.0.as_ptr().cast(), right.0.as_ptr().cast()]));
        let steps = &self.steps;
        // The last part of `left` times the first of `right`; with two parts then the first of both, and the first of `left`
        // times the last of `right`.
        if PARTS == 1 {
            sum_products!(
                steps,
                sums,
                add,
                "tileloadd tmm6, [{b} + {row}]",
                "tileloadd tmm4, [{a} + {row}]",
                "tdpbf16ps tmm0, tmm4, tmm6",
                "tileloadd tmm7, [{b} + {row} + 1024]",
                "tdpbf16ps tmm1, tmm4, tmm7",
                "tileloadd tmm5, [{a} + {row} + 1024]",
                "tdpbf16ps tmm2, tmm5, tmm6",
                "tdpbf16ps tmm3, tmm5, tmm7"
            );
        } else {
            sum_products!(
                steps,
                sums,
                add,
                "tileloadd tmm6, [{b} + {row}]",
                "tileloadd tmm4, [{a} + {row} + 2048]",
                "tdpbf16ps tmm0, tmm4, tmm6",
                "tileloadd tmm7, [{b} + {row} + 1024]",
                "tdpbf16ps tmm1, tmm4, tmm7",
                "tileloadd tmm5, [{a} + {row} + 3072]",
                "tdpbf16ps tmm2, tmm5, tmm6",
                "tdpbf16ps tmm3, tmm5, tmm7",
                "tileloadd tmm4, [{a} + {row}]",
                "tdpbf16ps tmm0, tmm4, tmm6",
                "tdpbf16ps tmm1, tmm4, tmm7",
                "tileloadd tmm5, [{a} + {row} + 1024]",
                "tdpbf16ps tmm2, tmm5, tmm6",
                "tdpbf16ps tmm3, tmm5, tmm7",
                "tileloadd tmm6, [{b} + {row} + 2048]",
                "tdpbf16ps tmm0, tmm4, tmm6",
                "tdpbf16ps tmm2, tmm5, tmm6",
                "tileloadd tmm7, [{b} + {row} + 3072]",
                "tdpbf16ps tmm1, tmm4, tmm7",
                "tdpbf16ps tmm3, tmm5, tmm7"
            );
        }
    }
}

/// Prefetches numbers into the cache.
#[inline(always)]
pub fn prefetch(numbers: &[f32]) {
    for line in numbers.chunks(16) {
        // SAFETY: a hint, which cannot fault.
        unsafe { _mm_prefetch::<_MM_HINT_T1>(line.as_ptr().cast()) };
    }
}

impl Drop for TileUnit {
    fn drop(&mut self) {
        let others = UNITS.get() - 1;
        UNITS.set(others);
        if others == 0 {
            // SAFETY: the processor has the instruction; no `TileUnit` of this thread needs the registers any more.
            unsafe { asm!("tilerelease", options(nomem, nostack, preserves_flags)) };
        }
    }
}
