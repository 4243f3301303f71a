"""Recordings with changed bytes are read with every inference stated, or refused with a message; nothing else."""

from __future__ import annotations

import wave
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from scipy.io import savemat

from hpe_rig.recordings import Recording, read_recording, read_settings
from hpe_rig.scene import SettingsError

PULSES, SAMPLES, RATE_HZ, PULSE_RATE_HZ, CARRIER_HZ = 12, 64, 40e6, 4e3, 5e6
TIME_S = np.arange(SAMPLES) / RATE_HZ
RF = np.cos(2 * np.pi * CARRIER_HZ * (TIME_S - 1e-9 * np.arange(PULSES)[:, None])) * np.hanning(SAMPLES)
RATES: Mapping[str, Any] = {"sample_rate_hz": RATE_HZ, "pulse_rate_hz": PULSE_RATE_HZ, "carrier_hz": CARRIER_HZ}
ECHOES = RATES | {"axes": "pulse,sample"}
MOTION = {"quantity": "displacement_m", "pulse_rate_hz": PULSE_RATE_HZ, "axes": "line,pulse"}


def hdf5(path: Path, values: Mapping[str, Any]) -> None:
    with h5py.File(path, "w") as file:
        for name, value in values.items():
            file[name] = value


def table(path: Path, head: str, delimiter: str = ",") -> None:
    rows = [delimiter.join(f"{value:.6e}" for value in (time_s, *RF[:, index])) for index, time_s in enumerate(TIME_S)]
    path.write_text(head + "\n" + "\n".join(rows) + "\n")


def wav(path: Path) -> None:
    with wave.open(str(path), "wb") as file:
        file.setparams((1, 2, 48000, RF.size, "NONE", ""))
        file.writeframes(np.rint(RF * 5000).astype("<i2").tobytes())


UFF = {
    "channel_data/data/real": RF[:, None, None, :],
    "channel_data/data/imag": 0 * RF[:, None, None, :],
    "channel_data/sampling_frequency": RATE_HZ,
    "channel_data/modulation_frequency": 0.0,
    "channel_data/PRF": PULSE_RATE_HZ,
    "channel_data/pulse/center_frequency": CARRIER_HZ,
}
ZEA = {
    "data/raw_data": RF[:, None, :, None, None],
    "scan/sampling_frequency": RATE_HZ,
    "scan/center_frequency": CARRIER_HZ,
    "scan/time_to_next_transmit": np.full((PULSES, 1), 1 / PULSE_RATE_HZ),
}
TEKTRONIX = "Model,MDO3024\n\nSample Interval,2.5e-08,\nVertical Units,V,\n\nTIME," + ",".join(["CH1"] * PULSES)
FORMATS: dict[str, tuple[str, Callable[[Path], None], Mapping[str, Any]]] = {
    "npy": ("a.npy", lambda path: np.save(path, RF), ECHOES),
    "npz": ("a.npz", lambda path: np.savez(path, rf=RF, fs=RATE_HZ, prf=PULSE_RATE_HZ), ECHOES),
    "uff": ("a.uff", lambda path: hdf5(path, UFF), {}),
    "zea": ("a.hdf5", lambda path: hdf5(path, ZEA), {}),
    "k-wave": ("a.h5", lambda path: hdf5(path, {"p": RF, "dt": 1 / RATE_HZ}), ECHOES),
    "oscilloscope": ("a.csv", lambda path: table(path, TEKTRONIX), {**RATES}),
    "german": ("b.csv", lambda path: table(path, "Zeit", ";"), {**RATES}),
    "wav": ("a.wav", wav, RATES | {"record_samples": SAMPLES}),
    "raw": ("a.raw", lambda path: RF.tofile(path), ECHOES | {"dtype": "float64", "shape": list(RF.shape)}),
    "displacement, npy": ("u.npy", lambda path: np.save(path, 1e-6 * RF.T), MOTION),
    "displacement, text": ("u.csv", lambda path: np.savetxt(path, 1e-6 * RF.T, delimiter=","), MOTION),
    "velocity, hdf5": ("v.h5", lambda path: hdf5(path, {"v": RF.T}), MOTION | {"quantity": "velocity_mm_per_s"}),
}
SLOW_FORMATS = {
    "mat": ("a.mat", lambda path: savemat(path, {"rf": RF, "fs": RATE_HZ}), ECHOES),
    "displacement, mat": ("u.mat", lambda path: savemat(path, {"u": 1e-6 * RF.T}), MOTION),
}


def mutated(content: bytes, rng: np.random.Generator) -> bytes:
    """Return ``content`` cut, without or with a repeated part, or with changed bytes."""
    kind, start = int(rng.integers(5)), int(rng.integers(len(content)))
    end = min(len(content), start + int(rng.integers(1, 200)))
    if kind == 0:
        return content[:start]
    if kind == 1:
        return content[:start] + content[end:]
    if kind == 2:
        return content[:end] + content[start:]
    changed = bytearray(content)
    # Headers are at the beginning.
    limit = len(content) if kind == 3 else min(len(content), 512)
    for index in rng.integers(limit, size=int(rng.integers(1, 8))):
        changed[index] = int(rng.integers(256))
    return bytes(changed)


def recording_or_error(path: Path, settings: Any, origins: Any, for_map: bool) -> Recording | SettingsError:
    try:
        return read_recording(path, settings, origins, for_map=for_map)
    except SettingsError as error:
        return error


def check_variants(name: str, seeds: range, folder: Path) -> None:
    """Read variants of the format ``name``; assert that each gives a recording or one message with a remedy."""
    file_name, write, settings = (FORMATS | SLOW_FORMATS)[name]
    good = folder / file_name
    write(good)
    stated, origins = read_settings(good, None, settings)
    recording = read_recording(good, stated, origins, for_map="quantity" in settings)
    assert np.isfinite(recording.values).all()
    content = good.read_bytes()
    for seed in seeds:
        good.write_bytes(mutated(content, np.random.default_rng([seed, len(name)])))
        outcome = recording_or_error(good, stated, origins, "quantity" in settings)
        if isinstance(outcome, Recording):
            assert outcome.inferred, seed
            continue
        text = str(outcome)
        assert "Try: " in text, (seed, text)
        # One line for each mistake, which a terminal can print.
        assert len(text.splitlines()) == len(outcome.mistakes) + 1, (seed, text)
        assert all(line.isprintable() for line in text.splitlines()), (seed, text)


@pytest.mark.parametrize("name", FORMATS)
def test_changed_files_give_a_recording_or_a_message(name: str, tmp_path: Path) -> None:
    check_variants(name, range(4), tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("name", [*FORMATS, *SLOW_FORMATS])
def test_many_changed_files_give_a_recording_or_a_message(name: str, tmp_path: Path) -> None:
    check_variants(name, range(4, 34), tmp_path)
