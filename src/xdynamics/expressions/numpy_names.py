"""Functions of numpy that the language of expressions has under a name of its own."""

# numpy's name of a function -> ours
NAMED = {
    "sin": "sin",
    "cos": "cos",
    "tan": "tan",
    "arcsin": "asin",
    "arccos": "acos",
    "arctan": "atan",
    "arctan2": "atan2",
    "sinh": "sinh",
    "cosh": "cosh",
    "tanh": "tanh",
    "exp": "exp",
    "log": "log",
    "sqrt": "sqrt",
    "absolute": "abs",
    "fabs": "abs",
    "sign": "sign",
    "hypot": "hypot",
    "maximum": "max",
    "minimum": "min",
    "fmax": "max",
    "fmin": "min",
    "floor": "floor",
    "ceil": "ceil",
    "rint": "round",
    "remainder": "mod",
    "mod": "mod",
}
COMPARED = {"greater": ">", "greater_equal": ">=", "less": "<", "less_equal": "<=", "equal": "==", "not_equal": "!="}
