"""The page `xdynamics help json`: what is in the JSON that verbs print."""

JSON_PAGE = """\
With --json standard output holds one JSON object in one line and nothing else; warnings and errors
go to standard error, and exit codes stay. These have it: run, extend, complete, show, check,
sample, table, sweep, fit, budget, certify, recheck, refine, compare, diagnose, validate, verify,
reproduce, enclose, methods, modes.
  xdynamics fit pendulum.toml bench.csv --parameter L --json | jq '.variables.estimate.values'
  xdynamics show fit.nc --json | jq '.variables | [.parameter_name.values, .estimate.values]'
  xdynamics budget ball.toml --quantity y --at "1 s" --json | jq -r '.variables.result.values'
Numbers have all their digits: reading them gives the same bits. JSON has none that are not finite:
  nan is null, infinity is the text "inf" or "-inf"
Every object has
  kind        what it is: run, model, verification, reproduction, states, table, methods, method,
              part (of a run), or the kind of evidence, as of `show`
  title       in words; verifications and methods have none
  archive     the file that was written, if one was; model is the fitted model that `fit` wrote
Evidence (fit, budget, certificate, refinement, comparison, diagnosis, ledger, sweep …), and what
`sample` gives, as in archives:
  sizes       number of entries along each dimension
  attributes  settings, digests, versions: texts and numbers
  variables   by name, each with
    dims      names of its dimensions, none for a single number
    units     in UDUNITS spelling, "1" for a pure number or a text
    long_name what it is, if that is said
    values    a number or text, else lists in lists in the order of dims; a flag by its words, like
              "passed"
A table:
  units       of each column
  rows        list of rows, each by the names of the columns
A run:
  outcome, text, method, force_evaluations, sizes, content_digest
  end         time and state at the end; units has the unit of each, time is in s
  events      list of name, kind, time, uncertainty (of the location)
  parameters  as variables above, with uncertainty where the model gives one
A model (check):
  digest, counts (of its parts), equations (lines)
  parameters, initial   by name: value, units, and of parameters uncertainty in that unit, 0 if none
                        is known
  methods     by name: order, chooses_steps, refuses (list of reasons, empty if the method takes the
              model)
  scales      the linearisation at the start, as evidence above: frequency, period,
              largest_stable_step …; or unknown, why not
A reproduction has these too; attributes.identical is 1 where every bit is the same.
Methods: methods, by name; a single one has these itself:
  order, evaluations in an evaluations_in (step | iteration), estimate_order (null: by step
  doubling), interpolation_order
  is (list of plain, symplectic, symmetric, implicit), refuses, synonyms (lists), equations,
  reference
  oscillation_limit, decay_limit   largest w*h and h/tau of a stable step; null where the method
                                   takes no such forces
A verification:
  archives    list of archive, verdict (verified | repacked | edited | damaged | not verified),
              digest of the first two, text
"""
