"""The fused multiply-add x*y + z, rounded once, as IEEE 754 defines it on every machine.

Where a processor has it, it is one instruction. Elsewhere it is made of whole numbers here, and not by the C library:
the product of two significands has 106 bits, the other term is put beside it among 256, and what falls below these is
noted in the last bit: rounded to odd, so that rounding once more is right (Boldo, Melquiond 2008, IEEE Trans. Comput.
57, 462, doi:10.1109/TC.2007.70819).
"""

from __future__ import annotations

import math
from fractions import Fraction

from xdynamics.elementary.numbers import Number

FMA = "fma"  # before the number of lanes, in names of functions of the text


def fma(x: Number, y: Number, z: Number) -> Number:
    """Return x*y + z with one rounding.

    Examples
    --------
    >>> fma(0.1, 10.0, -1.0)
    5.551115123125783e-17
    """
    for operand in (x, y, z):
        if not isinstance(operand, float | int):
            return operand.as_operand(x).fma(y, z)
    # here the product is exact or not finite, so the addition rounds alone
    if not (math.isfinite(x) and math.isfinite(y)) or x == 0.0 or y == 0.0:
        return x * y + z
    if not math.isfinite(z):  # whatever the product, which may be too large for a float
        return z
    exact = Fraction(x) * Fraction(y) + Fraction(z)
    try:
        # Python divides whole numbers with one rounding, to nearest, halves to even
        size = float(abs(exact))
    except OverflowError:
        size = math.inf
    return -size if exact < 0 else size  # the sign is left of what is below all numbers


def fma_definition(lanes: int, *, native: bool) -> str:
    """Print the function for a number of lanes, as an instruction or in whole numbers.

    Parameters
    ----------
    lanes : int
    native : bool
        Whether the processor has the instruction.
    """
    kind, suffix = ("double", "f64") if lanes == 1 else (f"<{lanes} x double>", f"v{lanes}f64")
    parameters = f"{kind} %x, {kind} %y, {kind} %z"
    if native:
        return (
            f"declare {kind} @llvm.fma.{suffix}({kind}, {kind}, {kind})\n"
            f"define internal {kind} @{FMA}.{lanes}({parameters}) alwaysinline {{\n"
            f"  %r = call {kind} @llvm.fma.{suffix}({parameters})\n  ret {kind} %r\n}}"
        )
    if lanes == 1:
        return _IN_WHOLE_NUMBERS
    lines, aggregate = [f"define internal {kind} @{FMA}.{lanes}({parameters}) {{"], "poison"
    for lane in range(lanes):
        lines += [f"  %{name}.{lane} = extractelement {kind} %{name}, i64 {lane}" for name in "xyz"]
        numbers = ", ".join(f"double %{name}.{lane}" for name in "xyz")
        lines.append(f"  %r.{lane} = call double @{FMA}.1({numbers})")
        lines.append(f"  %v.{lane} = insertelement {kind} {aggregate}, double %r.{lane}, i64 {lane}")
        aggregate = f"%v.{lane}"
    return "\n".join([*lines, f"  ret {kind} {aggregate}", "}"])


def _significand(name: str) -> str:
    """Print the significand of a number as a whole one, and the power of two that it is to be multiplied by."""
    return f"""  %{name}.bits = bitcast double %{name} to i64
  %{name}.shifted = lshr i64 %{name}.bits, 52
  %{name}.field = and i64 %{name}.shifted, 2047
  %{name}.fraction = and i64 %{name}.bits, 4503599627370495
  %{name}.small = icmp eq i64 %{name}.field, 0
  %{name}.finite = icmp ne i64 %{name}.field, 2047
  %{name}.leading = select i1 %{name}.small, i64 0, i64 4503599627370496
  %{name}.whole = or i64 %{name}.fraction, %{name}.leading
  %{name}.least = select i1 %{name}.small, i64 1, i64 %{name}.field
  %{name}.power = sub i64 %{name}.least, 1075
  %{name}.wide = zext i64 %{name}.whole to i256
  %{name}.none = icmp eq i64 %{name}.whole, 0
"""


# The product stands 70 bits up, so that a smaller term loses nothing but what decides no rounding; a larger one is put at
# most 190 bits up, where the product, of at most 106 bits, has fallen below half of its last place.
_IN_WHOLE_NUMBERS = f"""declare i256 @llvm.ctlz.i256(i256, i1)
declare i64 @llvm.smin.i64(i64, i64)
declare i64 @llvm.smax.i64(i64, i64)
define internal double @{FMA}.1(double %x, double %y, double %z) noinline {{
entry:
{"".join(map(_significand, "xyz"))}  %finite.xy = and i1 %x.finite, %y.finite
  %finite = and i1 %finite.xy, %z.finite
  %none = or i1 %x.none, %y.none
  %some = xor i1 %none, true
  %usual = and i1 %finite, %some
  br i1 %usual, label %exact, label %plain
plain:
  %product = fmul double %x, %y
  %sum = fadd double %product, %z
  %endless = xor i1 %z.finite, true
  %z.alone = and i1 %finite.xy, %endless
  %only = select i1 %z.alone, double %z, double %sum
  ret double %only
exact:
  %xy = mul i256 %x.wide, %y.wide
  %up = shl i256 %xy, 70
  %power.xy = add i64 %x.power, %y.power
  %power.up = sub i64 %power.xy, 70
  %ahead = sub i64 %z.power, %power.up
  %is.ahead = icmp sge i64 %ahead, 0
  %is.far = icmp sgt i64 %ahead, 190
  %to = select i1 %is.far, i64 190, i64 %ahead
  %left = select i1 %is.ahead, i64 %to, i64 0
  %behind = sub i64 0, %ahead
  %behind.most = call i64 @llvm.smin.i64(i64 %behind, i64 255)
  %right = select i1 %is.ahead, i64 0, i64 %behind.most
  %left.wide = zext i64 %left to i256
  %right.wide = zext i64 %right to i256
  %z.left = shl i256 %z.wide, %left.wide
  %z.right = lshr i256 %z.left, %right.wide
  %z.back = shl i256 %z.right, %right.wide
  %z.lost = icmp ne i256 %z.back, %z.left
  %z.note = zext i1 %z.lost to i256
  %z.placed = or i256 %z.right, %z.note
  %z.some = icmp ne i64 %z.whole, 0
  %drowned = and i1 %is.far, %z.some
  %xy.placed = select i1 %drowned, i256 1, i256 %up
  %power.far = sub i64 %z.power, 190
  %power = select i1 %drowned, i64 %power.far, i64 %power.up
  %signs = xor i64 %x.bits, %y.bits
  %xy.negative = icmp slt i64 %signs, 0
  %z.negative = icmp slt i64 %z.bits, 0
  %xy.turned = sub i256 0, %xy.placed
  %z.turned = sub i256 0, %z.placed
  %xy.signed = select i1 %xy.negative, i256 %xy.turned, i256 %xy.placed
  %z.signed = select i1 %z.negative, i256 %z.turned, i256 %z.placed
  %total = add i256 %xy.signed, %z.signed
  %negative = icmp slt i256 %total, 0
  %total.turned = sub i256 0, %total
  %size = select i1 %negative, i256 %total.turned, i256 %total
  %nothing = icmp eq i256 %size, 0
  br i1 %nothing, label %zero, label %round
zero:
  ret double 0.0
round:
  %leading.wide = call i256 @llvm.ctlz.i256(i256 %size, i1 true)
  %leading = trunc i256 %leading.wide to i64
  %surplus = sub i64 203, %leading
  %lowest = sub i64 -1074, %power
  %wanted = call i64 @llvm.smax.i64(i64 %surplus, i64 %lowest)
  %grows = icmp slt i64 %wanted, 0
  %grown = sub i64 0, %wanted
  %up.by = select i1 %grows, i64 %grown, i64 0
  %beyond = call i64 @llvm.smin.i64(i64 %wanted, i64 255)
  %down.by = select i1 %grows, i64 0, i64 %beyond
  %up.wide = zext i64 %up.by to i256
  %down.wide = zext i64 %down.by to i256
  %shifted.up = shl i256 %size, %up.wide
  %kept = lshr i256 %shifted.up, %down.wide
  %kept.back = shl i256 %kept, %down.wide
  %rest = sub i256 %shifted.up, %kept.back
  %unit = shl i256 1, %down.wide
  %half = lshr i256 %unit, 1
  %more = icmp ugt i256 %rest, %half
  %tie = icmp eq i256 %rest, %half
  %is.rounded = icmp ne i64 %down.by, 0
  %last = trunc i256 %kept to i1
  %tie.up = and i1 %tie, %last
  %over = or i1 %more, %tie.up
  %adds = and i1 %over, %is.rounded
  %added = zext i1 %adds to i64
  %kept.short = trunc i256 %kept to i64
  %whole = add i64 %kept.short, %added
  %place = add i64 %power, %wanted
  %field = add i64 %place, 1074
  %field.bits = shl i64 %field, 52
  %found = add i64 %whole, %field.bits
  %too.large = icmp sgt i64 %field, 2046
  %is.infinite = icmp uge i64 %found, 9218868437227405312
  %infinite = or i1 %too.large, %is.infinite
  %unsigned = select i1 %infinite, i64 9218868437227405312, i64 %found
  %sign = select i1 %negative, i64 -9223372036854775808, i64 0
  %bits = or i64 %unsigned, %sign
  %result = bitcast i64 %bits to double
  ret double %result
}}"""
