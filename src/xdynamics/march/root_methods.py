"""How events are located, and judged at instants where their functions are zero: by names, and as a record has it."""

EARLIEST_FIRST, ON_HERMITE, ONE_BY_ONE = "earliest first", "earliest first by Hermite", "one by one"
_EARLIEST_FIRST = (
    "the earliest of a step first, by inverse cubic Hermite interpolation of its function's values and rates, else ITP"
    " bracketing (Oliveira, Takahashi 2021, doi:10.1145/3423597), on re-integrated substeps; the right end is accepted"
)
ROOT_METHODS = {  # how events are located, as described in a record; version 0.2 had only the last, what followed it the second
    EARLIEST_FIRST: f"{_EARLIEST_FIRST}; steps that leave a polynomial are searched by its bounds",
    ON_HERMITE: _EARLIEST_FIRST,
    ONE_BY_ONE: (
        "ITP bracketing (Oliveira, Takahashi 2021, doi:10.1145/3423597) on re-integrated substeps; the right end is"
        " accepted"
    ),
}
# What becomes of an acting event whose function is zero where the motion starts or another event acts: it is judged by
# where the motion takes it, or, as in archives that do not say so, waits until its function has left zero.
JUDGED, WAITING = "judged", "waiting"
EVENT_STARTS = (JUDGED, WAITING)
