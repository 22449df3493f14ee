"""The elementary functions over arrays."""

from __future__ import annotations

import inspect

from xdynamics.elementary import FUNCTIONS, NAME
from xdynamics.elementary.text import declarations, definitions

NAMES = sorted(FUNCTIONS)


def count(name: str) -> int:
    """How many arguments a function takes."""
    return len(inspect.signature(FUNCTIONS[name]).parameters)


def loops(lanes: int, math_functions: str = NAME) -> str:
    """LLVM text that applies every function of a set, and the pair, to arrays."""
    kind = "double" if lanes == 1 else f"<{lanes} x double>"
    text = [declarations(lanes), definitions(dict.fromkeys([*NAMES, "sin_cos"], False), lanes, math_functions)]
    for name in NAMES:
        given = ", ".join([f"{kind} %a", f"{kind} %b"][: count(name)])
        text.append(f"""
define void @run_{name}(ptr %x, ptr %y, ptr %z, i64 %n) {{
entry:
  br label %each
each:
  %i = phi i64 [ 0, %entry ], [ %next, %each ]
  %xi = getelementptr double, ptr %x, i64 %i
  %yi = getelementptr double, ptr %y, i64 %i
  %zi = getelementptr double, ptr %z, i64 %i
  %a = load {kind}, ptr %xi, align 8
  %b = load {kind}, ptr %yi, align 8
  %found = call {kind} @elementary_{name}({given})
  store {kind} %found, ptr %zi, align 8
  %next = add i64 %i, {lanes}
  %more = icmp ult i64 %next, %n
  br i1 %more, label %each, label %done
done:
  ret void
}}""")
    return "\n".join(text)
