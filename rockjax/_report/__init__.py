"""The design report: the results of the checks in a problem file, as a page and as JSON, CSV and XLSX.

Terms:

- scene: the structure under one ground motion
- set: a named set of motions of the problem file, `[motions.NAME]`
- entry: a table `[[checks]]` or `[[targets]]` of the problem file
- check: an entry with its value and its result, such as PASS
- kind of a check: the name of its test, such as "peak-rotation" (folder `kinds`)
- kind of a quantity: what a number measures, such as "force" (`units.KINDS`)
- utilisation: U = value/limit, or limit/value if the limit is a minimum
- law: a law of impact, "paper" or "compatible"
- variation: a change of one input, or of the motions, by the factor 1 ± `spread`
"""
