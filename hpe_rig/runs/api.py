"""Public functions of ``hpe_rig``. A scene is a name, a path or a ``Scene``; a bench is the path of its file."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hpe_rig.bench import Bench, open_bench as open_instruments
from hpe_rig.measurement import BenchSource, prepare, provenance_now, record_run, source_text
from hpe_rig.result import Result, Stages
from hpe_rig.runs.arguments import known_laws, number_list, require_axes, require_numbers
from hpe_rig.runs.echoes import MAX_FREQUENCY_ACCURACY, EchoSettings, Samples, estimate_trains
from hpe_rig.runs.estimation import chosen_estimator
from hpe_rig.runs.result_warnings import incomplete_warnings
from hpe_rig.runs.run import Run, open_run
from hpe_rig.scene import Mistake, Scene, SceneSource, SettingsError, parse_scene
from hpe_rig.store import StoreError, WriteOptions, versions

if TYPE_CHECKING:
    from hpe_rig.moduli import DispersionResult, ModuliResult, Source
    from hpe_rig.processing import Estimates


def measure(scene: SceneSource, bench: BenchSource = None, path: str | os.PathLike[str] | None = None) -> Run:
    """Measure ``scene`` and return the run; every output is off when this returns or raises.

    ``path`` is the run file, never overwritten; default: SCENE.h5 in the current folder, numbered if it exists. Raises
    ``SettingsError`` with every mistake of scene or bench file, ``PlanError`` with every conflict, ``StoreError`` if
    the file cannot be written, ``InstrumentError`` if an instrument fails, and ``TypeError`` for a wrong type.

    >>> run = measure("bovine-muscle")
    >>> run.displacement_m(0).shape
    >>> print(run.estimate("coherent").to_frame())
    """
    setup = prepare(scene, bench)
    options = WriteOptions(provenance=provenance_now(setup.bench.bench))
    return open_run(record_run(setup, path, options=options))


def sweep(
    scene: SceneSource,
    axes: Mapping[str, Sequence[float] | NDArray[Any]],
    *,
    together: bool = False,
    bench: BenchSource = None,
    path: str | os.PathLike[str] | None = None,
) -> Run:
    """Measure ``scene`` at every value of the ``axes`` and return the run, one file with all shots; see ``measure``.

    ``axes``: values by the key of a number of the scene, or of the bench file as "bench.PATH". Each value is combined
    with each; with ``together`` the n-th values of all axes are combined. All points are checked before the first shot.
    Raises as ``measure``.

    >>> run = sweep("bovine-muscle", {"tracking.delay_s": [0.0, 50e-6], "simulation.receiver.snr_db": [20.0, 40.0]})
    >>> run.estimate().to_frame()[["tracking.delay_s", "simulation.receiver.snr_db", "amplitude_m"]]
    """
    require_axes(axes)
    # Other types than arrays and numbers stay: the scene reports them.
    values = {
        str(key): np.atleast_1d(numbers).tolist() if isinstance(numbers, np.ndarray | int | float) else numbers
        for key, numbers in axes.items()
    }
    settings = {"sweep.axes": values, "sweep.combine": "zip" if together else "product"}
    unswept = scene if isinstance(scene, Scene) else parse_scene(*source_text(scene)).scene
    return measure(unswept.with_(settings), bench, path)


@contextmanager
def open_bench(scene: SceneSource, bench: BenchSource = None) -> Iterator[Bench]:
    """Yield the instruments that ``scene`` needs, by role. At the end every output is switched off and verified.

    Raises as ``measure``.

    >>> with open_bench("bovine-muscle", "my-bench.toml") as bench:
    ...     print(bench.master.identify())
    """
    setup = prepare(scene, bench)
    with open_instruments(setup.scene.scene, setup.bench.bench, setup.plan.roles) as instruments:
        yield instruments


def fit_moduli(
    *runs: str | os.PathLike[str] | Run,
    laws: Sequence[str] = (),
    estimator: str | None = None,
    width_uncertainty: float = 0.05,
    common_amplitude: bool = True,
    profile_step_m: float | None = None,
) -> ModuliResult:
    """Return the moduli of the medium fitted to the vibrations of one or more runs at all lateral offsets.

    ``laws``: media to try, default all; ``estimator``: default the scene's; ``width_uncertainty``: relative
    uncertainty of the widths of the force; ``common_amplitude``: the force was the same at all lateral offsets, so that
    the decay of the amplitude is fitted; ``profile_step_m``: step of gates over depth, replacing those of the scenes.
    Raises as ``open_run``, ``SettingsError`` if a scene has no tonebursts or no [beams] or the runs' pushes differ, and
    ``StoreError`` if nothing can be estimated.

    >>> print(hpe.fit_moduli("gelatin-moduli.h5"))
    """
    from hpe_rig.moduli import moduli_of

    require_numbers("fit_moduli", width_uncertainty=width_uncertainty)
    fitted_laws = known_laws("fit_moduli", laws)
    with _sources("moduli", runs, estimator, profile_step_m) as sources:
        return moduli_of(sources, fitted_laws, estimator, width_uncertainty, common_amplitude)


def dispersion(
    *runs: str | os.PathLike[str] | Run,
    estimator: str | None = None,
    width_uncertainty: float = 0.05,
    common_amplitude: bool = True,
) -> DispersionResult:
    """Return phase velocity and attenuation of shear waves at every harmonic, from one or more runs.

    At least three lateral offsets are needed. The exact near field is fitted with one complex wave number for each
    frequency. Other methods are stated with their bias, as the exact field predicts it. Arguments and errors are those
    of ``fit_moduli``.

    >>> result = hpe.dispersion("gelatin-moduli.h5")
    >>> result.near_field.phase_velocity_m_per_s
    >>> result.figure().savefig("dispersion.pdf")
    """
    from hpe_rig.moduli import dispersion_of

    require_numbers("dispersion", width_uncertainty=width_uncertainty)
    with _sources("dispersion", runs, estimator, None) as sources:
        return dispersion_of(sources, estimator, width_uncertainty, common_amplitude)


@contextmanager
def _sources(
    command: str, runs: Sequence[str | os.PathLike[str] | Run], estimator: str | None, profile_step_m: float | None
) -> Iterator[list[Source]]:
    """Yield the stored ``runs`` for an inversion; a ``ValueError`` of the block becomes a ``StoreError``.

    Raises ``SettingsError`` without a run, if two files hold the same data, and for an unknown estimator.
    """
    from hpe_rig.moduli import Source

    stored_runs = [(run if isinstance(run, Run) else open_run(run)).with_profile(profile_step_m) for run in runs]
    if not stored_runs:
        raise SettingsError(command, [Mistake("", "no run is named", f"hpe-rig {command} RUN.h5")])
    _refuse_repeated_data(command, stored_runs)
    chosen_estimator(estimator, stored_runs[0].scene)
    try:
        yield [Source(run.path.name, run.scene, run.plan, run.stored) for run in stored_runs]
    except ValueError as error:
        raise StoreError(f"{stored_runs[0].path}: {error}") from error


def _refuse_repeated_data(command: str, runs: Sequence[Run]) -> None:
    """Raise ``SettingsError`` if two of the ``runs`` hold the same shots, which would count as independent data."""
    mistakes, first = list[Mistake](), dict[tuple[str, bytes], Run]()
    for run in runs:
        # Runs of scripts may have no identifier; the echoes of the first shot then distinguish runs of one scene.
        echoes = b"" if run.stored.run_id else run.stored.records[0].codes.tobytes()
        earlier = first.setdefault((run.identity, echoes), run)
        if earlier is not run:
            what = f"{run.path} is the same run as {earlier.path}, so that its data would count twice"
            mistakes.append(Mistake("RUN.h5", what, "every run once"))
        predecessors = (other for other in runs if other.path.name == run.stored.predecessor != run.path.name)
        for other in predecessors:
            what = f"{run.path} continues {other.path} and contains its shots, which would count twice"
            mistakes.append(Mistake("RUN.h5", what, f"{run.path} alone of these two"))
    if mistakes:
        raise SettingsError(command, mistakes)


def estimate(
    rf: ArrayLike,
    *,
    sample_rate_hz: float,
    pulse_rate_hz: float,
    carrier_hz: float,
    frequencies_hz: Sequence[float],
    sound_speed_m_per_s: float = 1540.0,
    estimator: str = "coherent",
    margin: tuple[int, int] = (0, 0),
    frequency_accuracy: float = 50e-6,
    drift: Literal["none", "linear"] = "none",
) -> Result:
    """Return amplitude and phase of the motion in gated echoes of any program.

    ``rf`` (..., pulse, sample), real: the samples of the gate in volts or codes, with pulses ``1 / pulse_rate_hz``
    apart. Whole numbers count as codes of a digitizer: their rounding is part of u, and full scale of integers of up to
    16 bits is reported. ``margin``: number of samples before and after the gate; six carrier periods on either side
    avoid edge effects. ``frequency_accuracy``: relative standard uncertainty of the frequencies by the clock of the
    pulses; 50e-6 for two quartz clocks, 0 for one clock. ``drift``: "linear" for a motion that changes; amplitude and
    phase are then those at the first pulse, otherwise means. A pulse with a sample that is not finite is missing. Each
    entry of the leading axes becomes a shot of the result, in C order; one without an estimate is left out, with a
    warning. Phases are those of sin(2 pi f t + phase) with t from the first pulse; displacement is positive away from
    the transducer. Raises ``TypeError`` if ``rf`` is not real, ``SettingsError`` for an unknown estimator, and
    ``ValueError`` for invalid settings and if no entry has an estimate.

    >>> rf = np.load("echoes.npy")
    >>> result = estimate(rf, sample_rate_hz=100e6, pulse_rate_hz=4e3, carrier_hz=9e6, frequencies_hz=[200.0])
    """
    samples = _real(rf, "rf", ("pulse", "sample"))
    require_numbers(
        "estimate",
        sample_rate_hz=sample_rate_hz,
        pulse_rate_hz=pulse_rate_hz,
        carrier_hz=carrier_hz,
        sound_speed_m_per_s=sound_speed_m_per_s,
        frequency_accuracy=frequency_accuracy,
    )
    stages, estimator_name = Stages(), chosen_estimator(estimator)
    settings = EchoSettings(
        sample_rate_hz=sample_rate_hz,
        pulse_rate_hz=pulse_rate_hz,
        carrier_hz=carrier_hz,
        frequencies_hz=number_list("estimate", "frequencies_hz", frequencies_hz),
        sound_speed_m_per_s=sound_speed_m_per_s,
        margin=_margin(margin),
        frequency_accuracy=frequency_accuracy,
        drift=drift,
    )
    with stages("process"):
        estimates = estimate_trains(samples.reshape(-1, *samples.shape[-2:]), settings, estimator_name)
    return _result(f"Echoes of shape {samples.shape}", estimator_name, estimates, stages)


def estimate_motion(
    motion: ArrayLike,
    *,
    pulse_rate_hz: float,
    frequencies_hz: Sequence[float],
    quantity: Literal["displacement_m", "velocity_m_per_s"] = "displacement_m",
    frequency_accuracy: float = 50e-6,
) -> Result:
    """Return amplitude and phase of a displacement or velocity that another program has estimated from its echoes.

    ``motion`` (..., pulse): displacement, m, or velocity, m/s, of one point every ``1 / pulse_rate_hz``; each entry of
    the leading axes becomes a shot of the result, in C order. Values that are not finite are missing. u combines the
    residual, as noise that is independent from pulse to pulse, with ``frequency_accuracy`` (``estimate``); errors of
    the scale, such as that of the sound speed, are not in it. Phases count from the first pulse. Raises ``TypeError``
    if ``motion`` is not real, and ``ValueError`` for invalid settings and if no entry has an estimate.

    >>> estimate_motion(np.load("shear-wave.npy"), pulse_rate_hz=10e3, frequencies_hz=[100.0, 200.0])
    """
    from hpe_rig.processing import estimate_stated_motion

    values = _real(motion, "motion", ("pulse",))
    require_numbers("estimate_motion", pulse_rate_hz=pulse_rate_hz, frequency_accuracy=frequency_accuracy)
    if quantity not in ("displacement_m", "velocity_m_per_s"):
        raise ValueError(f"quantity is {quantity!r}: 'displacement_m' or 'velocity_m_per_s'")
    if not 0 < pulse_rate_hz < np.inf or not 0 <= frequency_accuracy <= MAX_FREQUENCY_ACCURACY:
        rates = f"pulse_rate_hz is {pulse_rate_hz:g}, frequency_accuracy {frequency_accuracy:g}"
        raise ValueError(f"{rates}: a positive rate, and an accuracy from 0 to {MAX_FREQUENCY_ACCURACY:g}")
    wanted_hz = number_list("estimate_motion", "frequencies_hz", frequencies_hz)
    kind: Literal["displacement", "velocity"] = "velocity" if quantity == "velocity_m_per_s" else "displacement"
    series, stages = values.reshape(-1, values.shape[-1]).astype(np.float64), Stages()
    with stages("process"):
        estimates = estimate_stated_motion(series, pulse_rate_hz, wanted_hz, kind, frequency_accuracy)
    return _result(f"{kind.capitalize()} of shape {values.shape}", "least_squares", estimates, stages)


def _result(title: str, estimator: str, estimates: Estimates, stages: Stages) -> Result:
    """Return the result of arrays; phases count from their first pulse."""
    return Result(
        title=title,
        run_file="",
        simulated=False,
        status="complete",
        estimator=estimator,
        phase_reference="of sin(2 pi f t + phase), with t from the first pulse",
        shots=estimates.shots,
        warnings=tuple(incomplete_warnings(estimates)),
        omitted=(),
        versions=versions(),
        run_time_s=stages.run_time_s,
        shots_without_result=tuple((index + 1, why) for index, why in estimates.failures.items()),
    )


def _margin(margin: Any) -> tuple[int, int]:
    """Return ``margin``; raise an error if it is not two whole numbers."""
    if not isinstance(margin, Sequence) or len(margin) != 2:
        raise TypeError(f"estimate expects margin as two whole numbers, such as (64, 64), not {margin!r}")
    require_numbers("estimate", whole=True, margin=tuple(margin))
    return margin[0], margin[1]


def _real(array: ArrayLike, name: str, axes: Sequence[str]) -> Samples:
    """Return ``array`` as one; raise an error if it is not real, lacks one of the last ``axes`` or is empty."""
    values, last = np.asarray(array), f"(..., {', '.join(axes)})"
    if values.dtype.kind not in "iuf":
        raise TypeError(f"expected {name} as real numbers {last}, not {values.dtype}")
    if values.ndim < len(axes):
        raise ValueError(f"{name} has shape {values.shape}: it needs the axes {last}")
    if not values.size:
        raise ValueError(f"{name} has shape {values.shape}: it holds no {'echo' if name == 'rf' else name}")
    return values
