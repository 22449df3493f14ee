"""Models with dimensions that have every kind of expression: a chain, bodies, a truss, two fields, a ring, a lattice."""

from __future__ import annotations

CHAIN = """
name = "chain"
[dimensions]
site = 21
[relations.spring]
of = "site"
neighbours = 1
[coordinates]
u = { unit = "m", dims = ["site"] }
[parameters]
k = "4 N m-1"
b = { dims = ["spring"], value = "newton/metre**3*(1 + index(spring))" }
A = "0.1 m"
m = { dims = ["site"], value = "kilogram*(1 + 0.1*index(site))" }
[mass]
u = "m"
[definitions]
stretch = "second(u, spring) - first(u, spring)"
[forces.springs]
over = "spring"
potential = "k*stretch**2/2 + b*stretch**4/4"
[forces.ends]
potential = "k*(u[0] + u[-1])*(u - stretch[3])/2"
[forces.drag]
u = "-0.1*kilogram/second*v_u*index(site)"
[observables]
stretching = "stretch"
furthest = "max(u, site)"
[initial]
u = "A*sin(pi*(index(site) + 1)/(size(site) + 1))"
"""
BODIES = """
name = "bodies"
[dimensions]
body = 11
axis = ["x", "y", "z"]
[relations.pair]
of = "body"
[coordinates]
r = { unit = "m", dims = ["body", "axis"] }
theta = "rad"
[parameters]
G = "1 N m2 kg-2"
s = "0.1 m"
inertia = "2 kg m2 rad-2"
m = { dims = ["body"], value = "kilogram*(1 + 0.1*index(body))" }
[mass]
r = "m"
theta = "inertia"
[definitions]
distance = "sqrt(norm(second(r, pair) - first(r, pair), axis)**2 + s**2)"
[forces.gravity]
over = "pair"
potential = "-G*first(m, pair)*second(m, pair)/distance"
[forces.thrust]
r = "where(index(axis) < 1, 1*newton, 0*newton)*t/second + sin(theta/radian)*newton"
[forces.twist]
potential = "inertia*theta**2/(2*second**2) + newton*r[3, y]*theta/radian"
[regimes.on]
forces = ["gravity", "thrust", "twist"]
[regimes.off]
forces = ["gravity", "twist"]
[observables]
momentum = "sum(m*v_r, body)"
spin = "sum(m*cross(r, v_r, axis), body)"
[initial]
r = "metre*sin(3*index(body) + index(axis))*where(index(axis) > 1, 0, 1)"
theta = "1 rad"
"""
TRUSS = """
name = "truss"
[dimensions]
node = ["a", "b", "c", "d", "e", "lonely"]
axis = ["x", "y"]
[relations.bar]
of = "node"
table = "bars.csv"
csv = "first,second\\na,b\\nd,b\\nb,c\\ne,a\\nc,d\\nd,e\\na,c\\nb,e\\ne,c\\n"
[coordinates]
r = { unit = "m", dims = ["node", "axis"] }
[parameters]
stiffness = { dims = ["bar"], value = [1, 2, 3, 4, 5, 6, 7, 8, 9], unit = "N m-1" }
m = { dims = ["node"], values = { a = "1 kg", b = "2 kg", c = "1 kg", d = "1 kg", e = "3 kg", lonely = "1 kg" } }
[mass]
r = "m"
[definitions]
length = "norm(second(r, bar) - first(r, bar), axis)"
[forces.bars]
over = "bar"
potential = "stiffness*(length - 1*metre)**2/2"
[forces.dampers]
over = "bar"
r = "0.1*newton*second/metre*(second(v_r, bar) - first(v_r, bar))"
[observables]
length_of_bars = "length"
[initial]
r = "metre*(index(node) + 1)*cos(2*index(node) + index(axis))"
"""
REACTION = """
name = "reaction and diffusion"
[dimensions]
row = 5
cell = 17
[parameters]
D = "2 s-1"
feed = { dims = ["cell"], value = "(1 + index(cell))/second" }
[drives.bath]
table = "bath.csv"
csv = "t [s],bath [1]\\n0,1\\n5,2\\n9,0\\n"
[definitions]
around = "shift(a, cell, 1, bath) + roll(a, row, 1) + shift(a, cell, -1, 0) + roll(a, row, -1) - 4*a"
[states.a]
unit = "1"
dims = ["row", "cell"]
rate = "D*around + feed*a*(1 - a)*b - mean(a, cell)/second"
[states.b]
unit = "1"
dims = ["cell"]
rate = "(max(a, row) - b)/second"
smooth = true
[observables]
whole = "sum(a*b, row, cell)"
profile = "norm(a, row)"
[initial]
a = "sin(index(row)) + exp(-index(cell))"
b = "index(cell)/10"
"""
RING = """
name = "ring"
[dimensions]
site = 23
[coordinates]
u = { unit = "m", dims = ["site"] }
[parameters]
m = "1 kg"
k = { dims = ["site"], value = "newton/metre*(2 + sin(index(site)))" }
[mass]
u = "m*(1 + (u/metre)**2/10)"
[forces.springs]
u = "k*(roll(u, site, 1) - 2*u + roll(u, site, -2)) - 0.1*kilogram/second*v_u*abs(roll(v_u, site, 1)/(1*metre/second))"
[initial]
u = "metre*sin(index(site))"
"""
LATTICE = """
name = "lattice"
[dimensions]
row = 6
cell = 9
axis = ["x", "y", "z"]
[states.a]
unit = "1"
dims = ["row", "cell"]
rate = "(shift(a, cell, 2, b) + where(index(row) == 2, roll(a, row, 1), a**3) + size(row)*min(a, 0.3*b))/second"
[states.b]
unit = "1"
rate = "(a[0, -1]*exp(-b) + max(c, axis))/second"
[states.c]
unit = "1"
dims = ["axis"]
rate = "(cross(c, roll(c, axis, 1)*b, axis) - c*norm(c, axis) + dot(c, c, axis)/2 + min(a, row, cell))/second"
[initial]
a = "sin(index(row)) + exp(-index(cell))"
b = "0.5"
c = "1 + index(axis)"
[observables]
of_rows = "sum(a, cell) + norm(c, axis)"
"""
MODELS = {"chain": CHAIN, "bodies": BODIES, "truss": TRUSS, "reaction": REACTION, "ring": RING, "lattice": LATTICE}
