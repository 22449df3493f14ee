"""Shapes that cannot be: each is refused in one short line, at once, with the thing, its value and the remedy."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import pytest

import xdynamics as xd

CHAIN: dict[str, Any] = {
    "name": "chain",
    "dimensions": {"bead": ["a", "b", "c"], "site": 4},
    "relations": {"spring": {"of": "bead", "neighbours": 1}},
    "coordinates": {"u": {"unit": "m", "dims": ["bead"]}},
    "mass": {"u": "1*kilogram"},
    "initial": {"u": "0 m"},
}


def chain(**sections: Any) -> dict[str, Any]:
    """The chain with other sections."""
    return CHAIN | sections


def pulled(csv: str, dims: str = "bead") -> dict[str, Any]:
    """The chain with a drive for each element."""
    return chain(drives={"pull": {"csv": csv, "dims": [dims]}})


@pytest.mark.parametrize(
    ("statement", "said"),
    [
        (
            pulled("t [s],a [N],b [m],c [N]\n0,1,1,1\n1,2,2,2\n"),
            "'b' in 'm' beside 'a' in 'N'; elements of one quantity",
        ),
        (
            pulled("t [s],a [N],b [N],d [N]\n0,1,1,1\n"),
            "has no column 'c', and needs one for each element: a, b, c; it is",
        ),
        (
            pulled("t [s],x [N]\n0,1\n1,2\n", "site"),
            "no column 'pull_0' and 3 more, and needs .*: pull_0, pull_1, pull_2, pull_3",
        ),
        (
            pulled("t [s]," + ",".join(f"x{i} [N]" for i in range(2000)) + "\n"),
            "has no column 'a' and 2 more, .* 'x8 \\[N\\]' and 1991 more$",
        ),
        (
            chain(initial={"u": {"unit": "m", "value": [1.0, 2.0, float("nan")]}}),
            "initial value 'u': element 2, counted from 0: quantity nan is not finite",
        ),
        (
            chain(observables={"o": "u[1:2]"}),
            "has the character ':' at column 4; there are no slices: neighbours are shift",
        ),
        (
            chain(observables={"o": "prod(u, bead)"}),
            "function 'prod' is not known; .*of quantities with dimensions sum,",
        ),
        (
            chain(relations={"all": {"from": "site", "to": "site"}}),
            "relation 'all': links every element of 'site' with itself",
        ),
        (
            chain(relations={"all": {"from": "site", "to": "site", "csv": "first,second\n0,1\n1,0\n2,2\n"}}),
            "line 4: links '2' with itself; leave it out",
        ),
        (
            chain(
                dimensions={"bead": 10**6, "site": 10**6}, coordinates={"u": {"unit": "m", "dims": ["bead", "site"]}}
            ),
            "initial value 'u': has 1000000000000 elements along bead, site, which take 240 TB to march, .* take fewer",
        ),
        (
            chain(dimensions={"bead": [*range(10**5)]}),
            r"dimension 'bead': is \[0, 1, 2, .* …, needs a number of elements",
        ),
        (chain(dimensions={"bead": [*(f"b{i}" for i in range(50_000)), "b7"]}), "has the label 'b7' twice; give each"),
        (
            chain(dimensions=CHAIN["dimensions"] | {"spring": 3}),
            "'chain': relation 'spring' and dimension 'spring' have one",
        ),
        (
            chain(observables={"site": "u"}),
            "model 'chain': dimension 'site' and observable 'site' have one name; rename one$",
        ),
        (
            chain(observables={"o": "sum(u, site)"}),
            "goes along 'site', and 'u' has the dimensions: bead; take one of these",
        ),
        (
            chain(relations={"spring": {"of": "bead", "neighbours": 3}}),
            "relation 'spring': neighbours is 3, and 'bead' has 3 elements; write 2 at most$",
        ),
        (
            chain(relations={"spring": "bead"}),
            "relation 'spring': 'bead' must be a table of keys, such as of, neighbours",
        ),
        (
            chain(parameters={"k": [1.0, 2.0, 3.0]}),
            r"parameter 'k': value is a list of 3, needs the dimensions that it is along: \{ dims = \[\"…\"\], value =",
        ),
        (
            chain(parameters={"k": {"dims": ["bead"], "value": [1, 2, 3], "uncertainty": [0.1, 0.1]}}),
            "parameter 'k': uncertainty has 2 along 'bead', needs 3 elements$",
        ),
        (
            chain(parameters={"k": {"value": "2*index(bead)"}}),
            r"has the dimension 'bead', and it needs none; reduce it, as in sum\(…, bead\), or add it to dims$",
        ),
        (
            chain(parameters={"k": {"dims": ["bead"], "csv": "bead,k\na,1\nb,heavy\nc,3\n"}}),
            "parameter 'k': table 'k.csv', line 3: 'heavy' is no number$",
        ),
        (
            chain(initial={"u": {"csv": "u [m],w [m]\n1,2\n", "columns": ["u", "w"]}})
            | {"coordinates": {"u": {"unit": "m", "dims": ["site", "bead"]}}},
            "columns names 2, needs 3, one for each of 'bead': rows are of 'site'$",
        ),
        (
            chain(initial={"u": "0 m", "v_u[a]": "1 m s-1"}),
            r"initial value of 'v_u\[a\]', which is an element; give 'v_u' as a whole$",
        ),
        (
            chain(parameters={"g": "1 N"}, observables={"o": "g[a]"}),
            r"'g\[a\]' \(column 1\): 'g' has no dimensions, and therefore no elements$",
        ),
        (
            chain(parameters={"k": {"dims": ["bead"], "csv": "bead,k [N/mm2q]\na,1\nb,2\nc,3\n"}}),
            r"table 'k.csv', column 'k \[N/mm2q\]': unit 'N/mm2q' cannot be read at column 6",
        ),
        (
            chain(parameters={"k": {"dims": ["bead"], "csv": "k\n1\n2\n3\n"}}),
            "table 'k.csv', column 'k': it has no unit; write it like",
        ),
        (
            chain(parameters={"k": {"dims": ["bead"], "csv": "k [N]\n1\n-\n3\n"}}),
            r"table 'k.csv', line 3: column 'k \[N\]' has a gap; fill it$",
        ),
        (
            chain(dimensions={"bead": 10**6}, relations={"near": {"of": "bead", "neighbours": 400_000}}),
            "neighbours is 400000 of 1000000 elements, 400000000000 links, and 20000000 at most are made; write 20 at most",
        ),
        (
            chain(observables={"o": "sum(u, bead, bead)"}),
            r"'sum\(u, bead, bead\)' \(column 1\) goes along 'bead' twice; name it once$",
        ),
        (
            chain(observables={"o": "delayed(u, 1*second*(1 + index(bead)))"}),
            r"delayed values are of single numbers, and the model has \[dimensions\]; write its elements out$",
        ),
        (
            chain(dimensions={"bead": 2}, relations={}, observables={"o": "cross(u, 2*v_u, bead)"}),
            r"of 2 elements, and needs 3; in a plane write take\(u, bead, 0\)\*take\(2\*v_u, bead, 1\) - take\(u, bead, 1\)\*",
        ),
        (chain(observables={"o": "sum(u)"}), r"'sum' is written sum\(a, dimension\); number of arguments here: 1$"),
        (
            chain(observables={"o": "dot(u, u, site, axis)"}),
            r"arguments here: 4; over several dimensions write sum\(a\*b, site, axis\)$",
        ),
    ],
)
def test_it_is_refused_shortly_and_at_once(statement: dict[str, Any], said: str) -> None:
    """Assert that one line says what it is, however many elements there are, and nothing is allocated before."""
    begun = time.process_time()
    with pytest.raises(xd.ModelError, match=said) as refusal:
        xd.Model(**statement)
    assert time.process_time() - begun < 1.0
    assert len(str(refusal.value)) < 400
    assert "\n" not in str(refusal.value)


def test_directed_links_may_go_both_ways() -> None:
    """Assert that a table between a dimension and itself has links each way, which one of it has not."""
    both = {"csv": "first,second\n0,1\n1,0\n"}
    relation = xd.Model(**chain(relations={"to": {"from": "site", "to": "site"} | both})).shapes.relations["to"]
    assert [relation.first.tolist(), relation.second.tolist()] == [[0, 1], [1, 0]]
    with pytest.raises(xd.ModelError, match="line 3: the link of line 2 is there again"):
        xd.Model(**chain(relations={"to": {"of": "site"} | both}))


def test_a_table_of_many_columns_is_split_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that a drive for each of 50 elements reads its text as often as one for each of four."""
    from xdynamics.model.csv_sheet import Sheet

    split, read = Sheet.from_text, []
    monkeypatch.setattr(Sheet, "from_text", classmethod(lambda _, name, text: read.append(name) or split(name, text)))
    counts = []
    for n in (4, 50):
        read.clear()
        header = ",".join(f"pull_{i} [N]" for i in range(n))
        csv = f"t [s],{header}\n" + "".join(f"{t}{',2' * n}\n" for t in range(3))
        model = xd.Model(**chain(dimensions={"bead": 3, "site": n}, drives={"pull": {"csv": csv, "dims": ["site"]}}))
        counts.append(len(read))
        assert len(model.elements.drives) == n
    assert counts[0] == counts[1] > 0


@pytest.mark.parametrize(
    ("sections", "said"),
    [
        (
            {"validation": {"u": {"expression": "1*metre*index(site)", "bound": "1 m", "times": ["1 s"]}}},
            "validation 'u': .* has the dimension 'site', and it needs bead; reduce it",
        ),
        (
            {"drives": {"pull": {"csv": "x [m],pull [N]\n0,1\n1,2\n", "argument": "u"}}},
            "drive 'pull': argument: 'u' has the dimension 'bead', and it needs none; reduce it, as in sum.…, bead., or give the drive dims, and its table a column for each",
        ),
        (
            {"drives": {"pull": {"csv": "x [m],pull [N]\n0,1\n1,2\n", "argument": "u[q]"}}},
            "'chain': drive 'pull': argument: dimension 'bead' has no element q; it has the labels a, b, c",
        ),
        (
            {"contacts": {"floor": {"gap": "u - 1*metre*(1 + index(bead))", "restitution": 1}}},
            r"'chain': contact 'floor\[a\]': gap is -1 .* not negative; likewise for 2 more$",
        ),
    ],
)
def test_a_fault_of_all_elements_is_said_once(sections: dict[str, Any], said: str) -> None:
    """Assert that dimensions of tables' arguments and closed forms are checked, and elements are not listed."""
    with pytest.raises(xd.ModelError, match=said) as refusal:
        xd.simulate(xd.Model(**chain(**sections)), method="rk4", step="1 s", until="1 s")
    assert "\n" not in str(refusal.value)


def test_sizes_and_labels_may_be_numpys() -> None:
    """Assert that a number of elements and labels as numpy has them are those of a file."""
    sizes = {"bead": np.array(["a", "b", "c"]), "site": np.int64(4)}
    assert xd.Model(**chain(dimensions=sizes)) == xd.Model(**CHAIN)


def test_frictions_of_too_many_elements_are_told_what_to_be_instead() -> None:
    """Assert that the message names the friction, how many it has, and a contact or a smooth force in its place."""
    many = chain(dimensions={"bead": 25}, frictions={"floor": {"slip": "v_u", "kinetic": "1*newton"}}) | {
        "relations": {}
    }
    with pytest.raises(
        xd.ModelError, match=r"'floor' has 25 of them; write .* as \[contacts.floor\] .* or as a smooth"
    ):
        xd.Model(**many)
