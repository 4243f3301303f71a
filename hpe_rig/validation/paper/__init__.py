"""The paper's numbers and trends, compared with the results of a study.

`reproduction` lists the statements of the paper; `claims` and `judgement` judge each from a study's results. The
experiments of the paper on the twin are in scripts/validation/paper.
"""
