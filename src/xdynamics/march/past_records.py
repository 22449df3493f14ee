"""The named numbers of a march with delays."""

from __future__ import annotations

from xdynamics.march.lifetimes import record_type

# A delay, and the place in `p` of the number that tells its time from what was before the start.
DELAY = record_type("time", "flag")
# The past of a march with delays: how many pieces are kept, of `width` numbers each, from where on in `tables`, and at most
# which derivative a breaking point may jump in that is landed on; `slot` is the place of the first delay after the drives,
# `stretch` the number of that which the march is in, `crossing` 1 right after a breaking point, `aimed` where the trial
# ends at one; `evaluations` are those that a polynomial takes.
BOOK = record_type("", "pieces breaks stretch crossing aimed first width slot most evaluations")
