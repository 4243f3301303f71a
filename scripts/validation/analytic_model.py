"""The analytic bias and jitter beside Monte Carlo for every parameter of Figs. 5 to 11: where it holds, where not."""

from __future__ import annotations

import argparse
from dataclasses import replace

import numpy as np

from hpe_rig.processing import ESTIMATORS
from hpe_rig.validation import PARAMETERS, MotionCase, MotionRow, case_rows

BIAS, JITTER = 0.02, 0.15
"""Wanted: bias within 2 % of D_0, jitter within 15 %."""


def main() -> None:
    """Print one row a parameter's value and estimator, and how many hold."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--draws", type=int, default=1000)
    parser.add_argument("--snr-db", type=float, default=20.0)
    parser.add_argument("--estimators", nargs="+", default=["coherent", "kasai", "cross_spectrum"], choices=ESTIMATORS)
    chosen = parser.parse_args()
    print(
        f"{'parameter':16}{'value':>10} {'estimator':18}"
        f"{'bias/D0 %':>10}{'predicted':>10}{'jitter nm':>10}{'predicted':>10}"
    )
    held = total = 0
    for name, values in PARAMETERS.items():
        for value in values:
            case = replace(MotionCase(snr_db=chosen.snr_db), **{name: value})
            for row in case_rows(case, name, value, chosen.estimators, chosen.draws, 1):
                good = _print(row, case.amplitude_m)
                held, total = held + good, total + 1
    print(f"bias within {BIAS:.0%} of D_0 and jitter within {JITTER:.0%}: {held} of {total}")


def _print(row: MotionRow, amplitude_m: float) -> bool:
    measured = float(np.hypot(row.noise_jitter_m, row.speckle_jitter_m))
    predicted = float(np.hypot(row.predicted_noise_m, row.predicted_speckle_m))
    missed_bias = abs(row.predicted_bias_m - row.bias_m) > BIAS * amplitude_m
    missed_jitter = abs(predicted / measured - 1) > JITTER
    print(
        f"{row.parameter:16}{row.value:10.4g} {row.estimator:18}{row.bias_m / amplitude_m * 100:10.2f}"
        f"{row.predicted_bias_m / amplitude_m * 100:10.2f}{measured * 1e9:10.4g}{predicted * 1e9:10.4g}"
        f"{'  bias' if missed_bias else ''}{'  jitter' if missed_jitter else ''}",
        flush=True,
    )
    return not (missed_bias or missed_jitter)


if __name__ == "__main__":
    main()
