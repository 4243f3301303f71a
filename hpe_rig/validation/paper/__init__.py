"""Paper: its figures on the twin, its numbers and trends against the studies.

`experiments` runs scenes and writes the page of `twin` (Fig. 1, 14, interference, dose), `force_lines` (Fig. 15),
`muscle` (Fig. 16 to 19, Table II) and `sphere` (calibration); `reproduction` lists the paper's statements, each judged
by `claims` or `judgement` from a study's results.
"""
