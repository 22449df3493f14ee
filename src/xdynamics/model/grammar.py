"""The grammar of a model file: every section and every key, declared once.

Reading, writing and the help follow from these declarations: no key can be readable but undocumented, or read and lost.
"""

from __future__ import annotations

from xdynamics.keywords import KEYWORDS
from xdynamics.model import body_sections, entries, joint_sections
from xdynamics.model.controllers import MEMORY, OUTPUT, entries_of
from xdynamics.model.drives import GAPS, INTERPOLATIONS, JUMP, OUTSIDE, REFUSE
from xdynamics.model.given_values import dims_key
from xdynamics.model.kinds import (
    COEFFICIENT,
    COMPONENT,
    CONDITION,
    COUNT,
    CSV,
    DURATION,
    EXPRESSION,
    EXPRESSIONS,
    FLAG,
    FORMULA,
    INSTANTS,
    LINKS,
    PHASE,
    PLANE,
    POSITIVE,
    SIZE,
    TEXT,
    TIME_UNIT,
    UNIT,
    WAIT,
    Kind,
    name_kind,
    name_list_kind,
    raw,
    word_kind,
)
from xdynamics.model.lagrangian import Lagrangian
from xdynamics.model.links import links_table, make_links, read_extent, written_extent
from xdynamics.model.parts import (
    ACTIONS,
    DIRECTIONS,
    IMPACT_LAWS,
    ROOT_STATES,
    STRIKE,
    TANGENTIALS,
    Authorship,
    Coordinate,
    Fitted,
    Force,
    Observable,
    Pictured,
    Regime,
)
from xdynamics.model.section import DESCRIPTION, NEEDED, Key, Section
from xdynamics.model.statement import BOUND
from xdynamics.model.uncertainty import DISTRIBUTIONS, Discrepancy
from xdynamics.units import SECONDS

TOLERANCE = Key("time_tolerance", DURATION, "how well it is located", "that of the run")
PLACE = Key(
    "position_tolerance",
    POSITIVE,
    "how far from zero the function, or gap, may be at the accepted state",
    "what the time tolerance leaves",
)
SPREAD = (
    Key("uncertainty", raw("number in the value's unit, or quantity"), "standard uncertainty", "none"),
    Key(
        "half_width",
        raw("number in the value's unit, or quantity"),
        "half the width between bounds, in its place",
        "none",
    ),
    Key("distribution", word_kind(*DISTRIBUTIONS), "how it is distributed", "normal; with half_width rectangular"),
    Key("degrees_of_freedom", raw("number over 2"), "of the distribution t", "needed there"),
)
DIMS = Key(
    "dims",
    Kind("list of dimensions", dims_key, lambda dims, _: list(dims), ()),
    "its dimensions: it has a value for each of their elements",
    "none",
)
TABLED = (
    Key("values", raw("table of quantities by label"), "of a quantity with dimensions, a table in it for each further one", "value"),
    Key("table", raw("name of a CSV file"), "a row for each element, in order or with a column of labels that is named as the dimension", "value"),
    Key("column", raw("name of a column"), "of the table; one titled u(column) beside it has standard uncertainties: k [N/m],u(k) [N/m]", "named as the entry"),
    Key("columns", raw("list of names"), "of the table: one for each element along a second dimension", "column"),
    Key("csv", raw("text"), "the table itself, in the place of the file", "the file"),
)  # fmt: skip
READING = (
    Key(
        "skip", raw("whole number"), "of a file of an instrument, lines before its header", "found", is_rewritten=False
    ),
    Key(
        "header",
        raw("list of titles"),
        'with units, in the place of the file\'s own: ["t [s]", "x [mm]"]',
        "the file's",
        is_rewritten=False,
    ),
    Key("units", raw("table of units"), "of columns whose titles have none", "none", is_rewritten=False),
    Key(
        "argument_column",
        raw("name of a column"),
        "that the values are measured over: of a file whose first column is another one",
        "the first",
        is_rewritten=False,
    ),
    Key(
        "duplicates",
        word_kind("first", "last", "mean", JUMP),
        "of lines in a row with one argument, which value is taken; jump: both, the value before it and from it on",
        "refused",
        "table.duplicates",
        "",
    ),
    Key("time_zero", raw('time | "first"'), "what the times are counted from", "0", is_rewritten=False),
    Key("decimal", word_kind(".", ","), "decimal mark", "found", is_rewritten=False),
)
OF_EVENTS = (
    Key("function", COMPONENT.with_unit("any unit"), "what passes through zero; also a numba function. Beyond zero and back by less than four times what the step is estimated to err by is no passage: a smaller tolerance or step shows whether it is one", "needed without every", "searched"),
    Key("every", DURATION, "in its place: how often a periodic event is met, at exact multiples after the start; a period like 2*pi/w is written as a function, sin(w*t/2)", "none"),
    Key("phase", PHASE, "how long after the start a periodic event is first met, 0 for at the start", "one period"),
    Key("direction", word_kind(*DIRECTIONS), "which passages count", "either; of impacts falling"),
    Key("action", word_kind(*ACTIONS, STRIKE), "what is done there; impact takes the keys of a contact too", "record"),
    Key("to", name_kind("a regime"), "that a switch goes on in", "needed by switch", omitted=""),
    Key("count", COUNT, "the occurrence from which on to act", "1"),
    Key("root_state", word_kind(*ROOT_STATES), "where it is located: on shortened steps, or on the step's interpolant", "reintegrate", omitted="reintegrate"),
    Key("unit", UNIT, "of a function in Python", "1"),
    Key("set", EXPRESSIONS, "new values that a reset gives, from those before", "needed by reset", "reset"),
    TOLERANCE,
    PLACE,
    DESCRIPTION,
)  # fmt: skip
OF_CONTACTS = (
    Key(
        "gap", EXPRESSION.with_unit("m or rad"), "of coordinates and time; motion only where it is not negative", NEEDED
    ),
    Key(
        "restitution", COEFFICIENT.with_unit("1"), "coefficient, of what the law says; may read approach_speed", NEEDED
    ),
    Key("slip", COEFFICIENT.with_unit("m s-1"), "velocity along the surface", "needed by coulomb"),
    Key("friction", COEFFICIENT.with_unit("1"), "coefficient while it slips", "needed by coulomb"),
    Key("static", COEFFICIENT.with_unit("1"), "coefficient up to which it sticks", "friction"),
    Key("tangential", word_kind(*TANGENTIALS), "friction along the surface", "frictionless"),
    Key(
        "law",
        word_kind(*IMPACT_LAWS),
        "of impacts: Newton's restitution of rates, Poisson's of impulses, Newton's one by one, Stronge's of energy"
        " (one contact at a time)",
        "newton",
    ),
    TOLERANCE,
    PLACE,
    Key("rest_height", SIZE.with_unit("m"), "lower bounces may be skipped into rest", "1e-9 of the largest gap so far"),
    DESCRIPTION,
)

SECTIONS: dict[str, Section] = {
    "time": Section(
        "what time is measured in", "",
        (Key("unit", TIME_UNIT, "1 where time is a pure number, as in equations without dimensions: then until = \"20\"; another one, like h, is what times are shown in, and recorded in seconds", SECONDS.text, "text", SECONDS.text),),
        '[time]\nunit = "s"\n',
        make=entries.make_time_unit, field="time_unit",
    ),
    "dimensions": Section(
        "named dimensions of quantities: expressions are joined by them, as arrays of xarray are", "dimension",
        (Key("<name>", Kind("number of elements, or list of labels", read_extent, written_extent), "its elements"),),
        '[dimensions]\nbead = ["left", "middle", "right"]\nsite = 4\n',
        field="extents",
    ),
    "relations": Section(
        "which elements are linked: every two, neighbours, those of a table, or those of two dimensions", "relation",
        (
            Key("of", name_kind("a dimension"), "whose elements are linked: every two once, unless another key says which", "from, to", omitted=""),
            Key("neighbours", COUNT, "how many of the next elements each is linked with", "all", omitted=0),
            Key("ring", FLAG, "whether the last is a neighbour of the first", "false"),
            Key("from", name_kind("a dimension"), "of the first ends, where ends are of two dimensions: each with each", "of", "source", ""),
            Key("to", name_kind("a dimension"), "of the second ends", "of", "target", ""),
            Key("table", name_kind("a CSV file"), "with columns first and second: labels or numbers of the ends of each link", "none", omitted=""),
            Key("csv", CSV, "the table itself, in the place of the file", "the file", omitted=""),
            DESCRIPTION,
        ),
        '[relations.pair]\nof = "bead"\ndescription = "every two"\n[relations.spring]\nof = "site"\nneighbours = 1\nring = true\n'
        '[relations.hung]\nfrom = "bead"\nto = "site"\ntable = "hung.csv"\ncsv = "first,second\\nleft,0\\nright,3\\n"\n',
        full=links_table, make=make_links, own_tables=True,
    ),
    "bodies": Section(
        "rigid bodies that turn: each stands for coordinates, states, masses, definitions and forces", "body",
        body_sections.KEYS,
        '[bodies.frame]\nmass = "2 kg"\ninertia = ["0.1 kg m2", "0.2 kg m2", "0.25 kg m2"]\nattitude = "quaternion"\ndims = ["site"]\n'
        'points = { tip = ["0 m", "0 m", "0.3 m"] }\nforces = { weight = { force = ["0 N", "0 N", "-9.81*newton"], at = "tip", axes = "space" } }\n'
        'torques = { motor = { torque = ["0 N m", "0 N m", "0.1 N m"], axes = "body" } }\ndescription = "four of them"\n'
        '[bodies.frame.initial]\nposition = ["0 m", "0 m", "index(site)*metre"]\nattitude = { axis = [1, 0, 0], angle = "30 degree" }\nangular_velocity = ["0 rad s-1", "0 rad s-1", "9 rad s-1"]\n'
        '[bodies.gyroscope]\npivot = ["0 m", "0 m", "0 m"]\ninertia = [\n  ["2 g m2", "0 g m2", "0 g m2"],\n  ["0 g m2", "2 g m2", "0 g m2"],\n  ["0 g m2", "0 g m2", "1 g m2"],\n]\n',
        make=body_sections.Body, own_tables=True,
    ),
    "joints": joint_sections.SECTION,
    "coordinates": Section(
        "what moves; the velocity of x is v_x, its acceleration a_x", "coordinate",
        (Key("unit", UNIT, "of the coordinate; angles in rad or degree", NEEDED), DIMS, DESCRIPTION),
        '[coordinates]\nx = "m"\ntheta = { unit = "rad", description = "angle from the vertical" }\nu = { unit = "m", dims = ["site"] }\n',
        'its unit: "m"',
        make=Coordinate, brief="unit",
    ),
    "parameters": Section(
        "constants of the model", "parameter",
        (Key("value", raw("quantity, or a number beside unit; with dims also lists, or an expression of index(…)"), "of the parameter", NEEDED), Key("unit", raw("unit"), "where the value has none", "1"), *SPREAD, DIMS, *TABLED, DESCRIPTION),
        '[parameters]\nm = "0.2 kg"\nl = { value = 0.5, unit = "m", uncertainty = 1e-3, description = "length" }\n'
        'k = { value = "40 N m-1", half_width = "1 N m-1", distribution = "triangular" }\n'
        'c = { value = "0.1 kg s-1", uncertainty = 0.01, distribution = "t", degrees_of_freedom = 9 }\n'
        'load = { dims = ["bead"], values = { left = "1 kg", middle = "2 kg", right = "900 g" } }\n'
        'stretch = { dims = ["bead", "site"], table = "bead.csv", columns = ["a", "b", "c", "d"], csv = """\nbead,a [mm],b [mm],c [mm],d [mm]\nright,1,2,3,4\nleft,0,0,0,0\nmiddle,1,1,1,1\n""" }\n'
        'stiff = { dims = ["spring"], table = "springs.csv", column = "k", csv = "k [N/m]\\n1\\n2\\n1\\n2\\n" }\n',
        'its value: "9.81 m s-2", or with its standard uncertainty: "9.81 ± 0.01 m s-2"',
        full=entries.parameter_table, make=entries.make_parameter, short_form=entries.written_parameter,
    ),
    "mass": Section(
        "what multiplies the acceleration of each coordinate, and nothing else; where it jumps (where, floor) velocities are kept, unless a reset says else", "",
        (Key("<coordinate>", EXPRESSION.with_unit("kg (kg m2 of an angle)"), "mass or moment of inertia", NEEDED), Key("matrix", raw("rows of expressions"), "the whole mass matrix in their place, which may depend on coordinates", "")),
        '[mass]\nmatrix = [["2*m", "m*l*cos(theta)/radian"], ["m*l*cos(theta)/radian", "m*l**2/radian**2"]]\nu = "1*kilogram"\n',
    ),
    "lagrangian": Section(
        "energies, in the place of [mass]: the mass matrix, the force terms `inertia` (velocity terms) and `potential` follow", "",
        (
            Key("kinetic", EXPRESSION.with_unit("J"), "quadratic in velocities; of coordinates, velocities, t and parameters", NEEDED),
            Key("potential", EXPRESSION.with_unit("J"), "of coordinates, t, parameters and drives", "none"),
        ),
        '[lagrangian]\nkinetic = "m*(v_x**2 + l**2*v_theta**2/radian**2)/2 + m*l*cos(theta)*v_x*v_theta/radian"\npotential = "k*x**2/2"\n',
        "other forces, of drags and drives, stand in [forces] beside it; where the mass jumps velocities are kept, unless a reset says else",
        make=Lagrangian,
    ),
    "definitions": Section(
        "names for expressions that are used again", "definition", (Key("<name>", FORMULA.with_unit("any unit"), "may read other definitions"),),
        '[definitions]\nspeed = "hypot(v_x, l*v_theta/radian)"\n',
    ),
    "forces": Section(
        "force terms by name", "force",
        (
            Key("over", name_kind("a relation"), "a component is the force on the first end of each link, its opposite acts on the second (of another coordinate, of which the same is written: u = f and w = f); of a potential, along what it is", "none", omitted=""),
            Key("potential", EXPRESSION.with_unit("J"), "the force is its negative gradient, and energies are known; it is summed over its dimensions", "components"),
            Key("<coordinate>", COMPONENT.with_unit("N (N m of an angle)"), "component of the (generalised) force; also a numba function", "", "components"),
            Key("smooth", FLAG, "its abs, sign, min, max, where are no switches to be located", "false"),
            DESCRIPTION,
        ),
        '[forces.gravity]\npotential = "-m*9.81*newton/kilogram*l*cos(theta)"\n'
        '[forces.drag]\nx = "-c*v_x"\ntheta = "-c*l**2*v_theta/radian"\nsmooth = true\ndescription = "of the air"\n'
        '[forces.chain]\nover = "spring"\nu = "stiff*(second(u, spring) - first(u, spring))"\n',
        full=entries.force_table, make=Force, own_tables=True,
    ),
    "drives": Section(
        "measured tables, which expressions read by name", "drive",
        (
            Key("table", name_kind("a file"), "a table beside the model (CSV, Excel, netCDF, Parquet, HDF5, .mat), whose header has units, time [s],pull [N], u(pull) [N] for standard uncertainties of rows that are independent, u_common(pull) [N] for one that is common to all rows (a calibration); commas, semicolons or tabs; or a file of an instrument (`xdynamics help files`); in Python also a DataFrame, a DataArray, or a mapping of headers to arrays", "needed without csv", "table.name"),
            Key("argument", EXPRESSION.with_unit("the unit of the first column"), "what it is measured over: t, a coordinate, a velocity, or an expression, like v*t or x - x0; with dims each element's own", "t"),
            Key("interpolation", word_kind(*INTERPOLATIONS), "between its points", "linear"),
            Key("outside", word_kind(*OUTSIDE), "beyond its ends", "error"),
            Key("column", name_kind("a column, or its whole header"), "of the values, where a table has several columns of them", "the only one", "table.column", ""),
            Key("gaps", word_kind(*GAPS), "lines in which a number is missing", "refuse", "table.gaps", REFUSE),
            *READING,
            Key("csv", CSV, "the table itself, in the place of the file", "the file", "table.text"),
            DIMS,
            DESCRIPTION,
        ),
        '[drives.pull]\ntable = "pull.csv"\ncsv = "t [s],pull [N]\\n0,0\\n2,3\\n9,0\\n"\ninterpolation = "pchip"\noutside = "zero"\n'
        '[drives.soft]\ntable = "soft.csv"\ncsv = "x (mm);soft (N);u(soft) (N);heat/K\\n-900;5,0;0,1;290\\n0;;;291\\n900;-5,0;0,1;292\\n"\ncolumn = "soft"\ngaps = "skip"\nargument = "x"\ndescription = "measured spring"\n'
        '[drives.swing]\ntable = "tracked.txt"\ncsv = "mass A\\nframe;t;y\\n1;2,0;1,5\\n2;2,1;1,6\\n3;2,1;1,7\\n"\nskip = 1\nunits = { t = "s", y = "mm" }\nargument_column = "t"\ncolumn = "y"\nduplicates = "mean"\ntime_zero = "2 s"\ndecimal = ","\n'
        '[drives.scope]\ntable = "scope.txt"\ncsv = "0 1\\n1 2\\n"\nheader = ["t [s]", "CH1 [V]"]\n'
        '[drives.bath]\ntable = "bath.csv"\ncsv = "t [s],left [K],middle [K],right [K]\\n0,290,291,292\\n9,300,300,300\\n"\ndims = ["bead"]\n',
        full=entries.drive_table, make=entries.make_drive, own_tables=True,
    ),
    "states": Section(
        "first-order companions of the motion: fuel, charge, memory of a controller", "state",
        (Key("unit", UNIT, "of the state", NEEDED), Key("rate", EXPRESSION.with_unit("that unit per second"), "how fast it changes; terms are added to it. It may read accelerations, a_x**2, where neither contacts nor constraints change them", "needed without terms", "written_rate", None), Key("terms", EXPRESSIONS, "parts of the rate by name, which are added to it; one that regimes list acts in these alone, others always", "none"), Key("smooth", FLAG, "as of forces", "false"), DIMS, DESCRIPTION),
        '[states.fuel]\nunit = "kg"\nrate = "-1e-3*kilogram/second*abs(v_x)/(1*metre/second)"\nsmooth = true\ndescription = "what is left"\n'
        '[states.warmth]\nunit = "J"\ndims = ["bead", "site"]\nrate = "-warmth/(3*second)"\n'
        '[states.room]\nunit = "K"\nterms = { loss = "-(room - 280*kelvin)/hour", heater = "20*kelvin/hour" }\n',
        make=entries.make_state, own_tables=True,
    ),
    "initial": Section(
        "where the motion starts: t, every coordinate, velocity and state", "initial value",
        (Key("value", raw("quantity, or a number beside unit; with dimensions also lists; or an expression of parameters and index(…)"), "at the start", NEEDED), Key("unit", raw("unit"), "where the value has none", "1"), *SPREAD, *TABLED, DESCRIPTION),
        '[initial]\nt = "0 s"\nx = { value = "10 mm", uncertainty = 0.1, description = "read off the scale" }\nv_x = "0 m s-1"\n'
        'theta = "30 degree"\nv_theta = "0 rad s-1"\nfuel = "10 g"\nroom = "290 K"\nregime = "pulled"\nconsistent = true\n'
        'u = { table = "start.csv", column = "u", csv = "site,u [mm]\\n3,1\\n0,0\\n1,2\\n2,1\\n" }\nv_u = { values = { 0 = "0 m s-1", 1 = "1 mm s-1", 2 = "0 m s-1", 3 = "0 m s-1" } }\n'
        'warmth = { table = "warmth.csv", columns = ["a", "b", "c", "d"], csv = """\na [J],b [J],c [J],d [J]\n1,2,3,4\n0,0,0,0\n1,1,1,1\n""" }\n',
        'its value: "20 m s-1"; regime = "coast" names the regime that it begins in, else the first; a velocity that is not there is 0; consistent = true moves it to where constraints hold',
        full=entries.parameter_table, make=entries.make_parameter, short_form=entries.written_parameter,
    ),
    "history": Section("what delayed(x, tau) reads before the start; without it the value at the start", "history", (Key("<name>", FORMULA.with_unit("of t and parameters"), "what a coordinate, velocity or state was before the start", "the value at the start"),),
        '[history]\nv_theta = "0.1*radian/second*cos(t/second)"\n',
    ),
    "events": Section(
        "functions whose zeros are located, and what is done there", "event", OF_EVENTS,
        '[events.turn]\nfunction = "v_x"\ndirection = "falling"\ntime_tolerance = "1 ns"\nposition_tolerance = "1 um s-1"\n'
        '[events.release]\nfunction = "t - 2*second"\naction = "switch"\nto = "free"\ndescription = "the string is cut"\n'
        '[events.wall]\nfunction = "2*metre - x"\ndirection = "falling"\naction = "reset"\nset = { v_x = "-0.9*v_x" }\nroot_state = "interpolant"\n'
        '[events.third]\nfunction = "theta"\naction = "stop"\ncount = 3\n'
        '[events.push]\nevery = "0.5 s"\nphase = "0.2 s"\naction = "reset"\nset = { v_x = "v_x + 0.1*metre/second" }\n',
        make=entries.make_event, own_tables=True,
    ),
    "contacts": Section(
        "unilateral contacts: impacts, rest, take-off, Coulomb's friction", "contact", OF_CONTACTS,
        '[contacts.floor]\ngap = "x + 1*metre"\nrestitution = "0.8*exp(-approach_speed/(9*metre/second))"\nrest_height = "1 nm"\nposition_tolerance = "1 nm"\nlaw = "poisson"\n'
        '[contacts.pad]\ngap = "3*metre - x"\nrestitution = 0.5\nlaw = "poisson"\ntangential = "coulomb"\nslip = "l*v_theta/radian"\nfriction = 0.3\nstatic = 0.4\ntime_tolerance = "1 ps"\ndescription = "rubber"\n',
        make=entries.make_contact, own_tables=True,
    ),
    "frictions": Section(
        "dry friction with true stick, where the normal load is known", "friction",
        (
            Key("slip", EXPRESSION.with_unit("m s-1 (rad s-1)"), "relative velocity, linear in velocities", NEEDED),
            Key("kinetic", COEFFICIENT.with_unit("N"), "how large the force is while it slips", NEEDED),
            Key("static", COEFFICIENT.with_unit("N"), "the most that sticking holds", "kinetic"),
            TOLERANCE, DESCRIPTION,
        ),
        '[frictions.belt]\nslip = "v_x - 0.1*metre/second"\nkinetic = "0.2*newton"\nstatic = "0.4*newton"\ntime_tolerance = "1 ns"\ndescription = "felt"\n',
        make=entries.make_friction, own_tables=True,
    ),
    "constraints": Section(
        "what a motion keeps: rods, guides, gears, rolling without slipping; the force of each is found with the accelerations", "constraint",
        (
            Key("holds", CONDITION.with_unit("any unit"), "an expression of coordinates and time that stays zero. The force on a coordinate is constraint_force_<name> times the derivative of this by it", "needed without rolls"),
            Key("rolls", CONDITION.with_unit("any unit"), "an expression linear in velocities that stays zero. The force on a coordinate is constraint_force_<name> times the derivative of this by its velocity", "needed without holds"),
            DESCRIPTION,
        ),
        '[constraints.rod]\nholds = "(x**2 - l**2)/(2*metre)"\ndescription = "of steel"\n[constraints.wheel]\nrolls = "v_x - l*v_theta/radian"\n',
        full=entries.constraint_table, make=entries.make_constraint, brief="holds", own_tables=True,
    ),
    "controllers": Section(
        "sampled controllers: at each tick all values are computed from the state just before it; a tick is a node of the run, not an event; in their expressions floor, ceil, round and mod take a number that is whole to rounding as whole: mod(t, T) is 0 at each multiple of T", "controller",
        (
            Key("every", DURATION, "the period; ticks lie at exact multiples of it, the first at the start. The controller's own expressions may read it as `every`", NEEDED),
            Key("phase", WAIT, "how long after the start the first tick is", "0"),
            Key("delay", WAIT, "from a tick until its outputs take effect, such as a computing time; it may be several periods", "0"),
            Key("outputs", entries_of(OUTPUT), "numbers that are held from tick to tick, which forces read by name as they do states", NEEDED),
            Key("states", entries_of(MEMORY), "memory of the controller, such as integrals, filtered values, modes: updated at ticks, without delay", "none"),
            DESCRIPTION,
        ),
        '[controllers.brake]\nevery = "10 ms"\nphase = "2 ms"\ndelay = "1 ms"\ndescription = "PI, sampled"\n'
        '[controllers.brake.outputs.grip]\nunit = "N"\nstart = "0 N"\nvalue = "-3*newton/metre*(x + integral/second)"\nminimum = "-5 N"\nmaximum = "5*newton"\ndescription = "of the motor"\n'
        '[controllers.brake.states.integral]\nunit = "m s"\nstart = "0 m s"\nnext = "integral + x*every"\ndescription = "of the deviation"\n',
        make=entries.make_controller, own_tables=True,
    ),
    "regimes": Section(
        "which forces, and which terms of rates, act together while a regime lasts (a thermostat's heater, say); events with action = 'switch' lead from one to another; the first one is that of the start, unless [initial] regime names another", "regime",
        (
            Key("forces", name_list_kind("the forces that act in it"), "the forces that act", "none", omitted=()),
            Key("terms", name_list_kind("the terms of rates that act in it"), "the terms of states' rates that act", "none", omitted=()),
            DESCRIPTION,
        ),
        '[regimes.pulled]\nforces = ["gravity", "drag", "chain"]\nterms = ["heater"]\ndescription = "by the motor"\n[regimes.free]\nforces = ["gravity"]\n',
        make=Regime, own_tables=True,
    ),
    "observables": Section(
        "what else is recorded along the run and at events", "observable",
        (Key("expression", FORMULA.with_unit("any unit"), "what is recorded", NEEDED), Key("unit", UNIT, "that it is recorded in", "the SI unit"), DESCRIPTION),
        '[observables]\nheight = "-l*cos(theta)"\nspeed_of_it = { expression = "v_x", unit = "km h-1", description = "as on a speedometer" }\n',
        'its expression: "m*v_x"',
        make=Observable, field="observed", brief="expression", short_form=entries.written_observable,
    ),
    "validation": Section(
        "closed forms that a run is compared with by `xdynamics validate`", "validation",
        (
            Key("quantity", name_kind("one"), "a coordinate, velocity, state, energy, observable, contact force; at an event also t", "the table's name"),
            Key("expression", FORMULA.with_unit("of t and parameters"), "what the quantity is to be", NEEDED),
            Key("bound", BOUND, "the most that it may be off, or how that follows", NEEDED),
            Key("event", name_kind("an event"), "after which it is compared", "none", omitted=""),
            Key("occurrence", COUNT, "which of these", "1", omitted=0),
            Key("times", INSTANTS, "where it is compared", "at every accepted state"),
            DESCRIPTION,
        ),
        '[validation.x]\nexpression = "0.01*metre"\nbound = "1 km"\ntimes = ["0 s", "1 s"]\ndescription = "at rest"\n'
        '[validation.first_turn]\nquantity = "t"\nexpression = "0*second"\nbound = "order"\nevent = "turn"\noccurrence = 1\n',
        "expression and bound are both needed",
        full=entries.closed_form_table, make=entries.make_closed_form, own_tables=True,
    ),
    "correlations": Section(
        "correlation coefficients of uncertain inputs", "", (Key("<name>", raw("table of numbers from -1 to 1"), "by the other name", "0"),),
        "[correlations]\nl = { x = 0.3 }\n",
    ),
    "discrepancy": Section(
        "what the model itself may have a quantity wrong, declared by its author", "discrepancy",
        (Key("standard", SIZE, "standard uncertainty", NEEDED), DESCRIPTION),
        '[discrepancy]\nx = { standard = "1 mm", description = "no wind in it" }\n',
        'its standard uncertainty: "1 mm"',
        make=Discrepancy, brief="standard",
    ),
    "fit": Section(
        "what the numbers of the model were fitted to, as `fit` writes it", "",
        (
            Key("data", name_kind("a CSV file"), "name of the measured data", "none"),
            Key("adequate", FLAG, "whether the residuals support the fit: budgets refuse a model whose fit they do not support, unless asked to take it", "true", omitted=None),
            DESCRIPTION,
        ),
        '[fit]\ndata = "bench.csv"\nadequate = true\ndescription = "residuals are no more than noise"\n',
        make=Fitted,
    ),
    "figure": Section(
        "what pictures and animations show of the motion in a plane", "",
        (
            Key("plane", PLANE.with_unit("or a list of pairs"), "where bodies are, or a phase plane, across and up: of coordinates, velocities, states, t, parameters", "the coordinates"),
            Key("bodies", name_list_kind("the pairs of plane"), "what the pairs of plane are called, in their order", "none"),
            Key("links", LINKS, "rods from body to body, in films and where pictures start; `origin` is the point 0, 0", "none"),
            Key("springs", LINKS, "springs, likewise", "none"),
            Key("threads", LINKS, "threads, likewise", "none"),
            Key("section", EXPRESSION.with_unit("s, of parameters"), "the period of a drive: Poincare's section has a dot in each", "none"),
            Key("wrap", name_list_kind("angles"), "drawn within half a turn to either side", "none"),
        ),
        '[figure]\nplane = [["x", "0*metre"], ["x + l*sin(theta)", "-l*cos(theta)"]]\nbodies = ["cart", "bob"]\nlinks = [["cart", "bob"]]\nsprings = [["origin", "cart"]]\nthreads = [["origin", "bob"]]\nsection = "2*pi*sqrt(m/k)"\nwrap = ["theta"]\n',
        "without it two coordinates of one unit are a plane, three are seen from three sides; of many bodies r over body and axis",
        make=Pictured, field="pictured",
    ),
    "about": Section(
        "who stands for the model and its runs, as attributes of every record, outside of its content", "",
        (
            Key("creator", TEXT, "who made it: attribute creator_name", "none", omitted=""),
            Key("institution", TEXT, "where", "none", omitted=""),
            Key("license", TEXT, "under which terms", "none", omitted=""),
            Key("id", TEXT, "by which it is found, as a DOI", "none", omitted=""),
            Key("references", TEXT, "where it is described", "none", omitted=""),
            Key("comment", TEXT, "anything else", "none", omitted=""),
        ),
        '[about]\ncreator = "A. Noether"\ninstitution = "Göttingen"\nlicense = "CC-BY-4.0"\nid = "doi:10.1000/182"\nreferences = "lesson 4"\ncomment = "second series"\n',
        make=Authorship,
    ),
    "run": Section(
        "defaults of `xdynamics run`, each an option of the command too", "",
        tuple(Key(name, raw(key.value_form), key.about, key.default) for name, key in KEYWORDS.items() if key.example),
        "[run]\n" + "".join(f"{name} = {key.example}\n" for name, key in KEYWORDS.items() if key.example),
    ),
}  # fmt: skip

# the keys above all sections
HEAD = (Key("name", TEXT, "of the model, first of all", NEEDED), DESCRIPTION)
