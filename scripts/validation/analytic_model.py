"""Compare analytic bias and jitter with Monte Carlo, for every parameter of Figs. 5 to 11."""

from __future__ import annotations

import argparse
from dataclasses import replace

import numpy as np

from hpe_rig.processing import ESTIMATORS
from hpe_rig.validation import PARAMETERS, MotionCase, MotionRow, case_rows

BIAS_LIMIT, JITTER_LIMIT = 0.02, 0.15
"""Allowed error of the bias relative to D_0, and of the jitter relative to itself."""


def main() -> None:
    """Print one row per value and estimator, and the number of rows within both limits."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--draws", type=int, default=1000)
    parser.add_argument("--snr-db", type=float, default=20.0)
    parser.add_argument("--estimators", nargs="+", default=["coherent", "kasai", "cross_spectrum"], choices=ESTIMATORS)
    arguments = parser.parse_args()
    print(
        f"{'parameter':16}{'value':>10} {'estimator':18}"
        f"{'bias/D0 %':>10}{'predicted':>10}{'jitter nm':>10}{'predicted':>10}"
    )
    passed = total = 0
    for name, values in PARAMETERS.items():
        for value in values:
            case = replace(MotionCase(snr_db=arguments.snr_db), **{name: value})
            for row in case_rows(case, name, value, arguments.estimators, arguments.draws, 1):
                passed += _print(row, case.amplitude_m)
                total += 1
    print(f"bias within {BIAS_LIMIT:.0%} of D_0 and jitter within {JITTER_LIMIT:.0%}: {passed} of {total}")


def _print(row: MotionRow, amplitude_m: float) -> bool:
    """Print the row; return whether bias and jitter are within their limits."""
    measured = float(np.hypot(row.noise_jitter_m, row.speckle_jitter_m))
    predicted = float(np.hypot(row.predicted_noise_m, row.predicted_speckle_m))
    wrong_bias = abs(row.predicted_bias_m - row.bias_m) > BIAS_LIMIT * amplitude_m
    wrong_jitter = abs(predicted / measured - 1) > JITTER_LIMIT
    print(
        f"{row.parameter:16}{row.value:10.4g} {row.estimator:18}{row.bias_m / amplitude_m * 100:10.2f}"
        f"{row.predicted_bias_m / amplitude_m * 100:10.2f}{measured * 1e9:10.4g}{predicted * 1e9:10.4g}"
        f"{'  bias' if wrong_bias else ''}{'  jitter' if wrong_jitter else ''}",
        flush=True,
    )
    return not (wrong_bias or wrong_jitter)


if __name__ == "__main__":
    main()
