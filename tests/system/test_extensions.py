"""The example package, installed, brings an estimator, a medium and an importer; what fails names its package."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
import textwrap
import tomllib
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]
EXAMPLE = ROOT / "docs" / "example-plugin"


def install(source: Path, site: Path, points: dict[str, dict[str, str]], name: str, version: str) -> None:
    """Put the package ``source`` into ``site`` with the metadata that an installer would write."""
    shutil.copytree(source, site / source.name, ignore=shutil.ignore_patterns("__pycache__"))
    metadata = site / f"{name.replace('-', '_')}-{version}.dist-info"
    metadata.mkdir(parents=True)
    (metadata / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n", encoding="utf-8")
    groups = [
        f"[{group}]\n" + "".join(f"{key} = {value}\n" for key, value in of.items()) for group, of in points.items()
    ]
    (metadata / "entry_points.txt").write_text("\n".join(groups), encoding="utf-8")


def run(site: Path, code: str) -> Any:
    """Return what ``code`` prints as JSON on its last line, run where the packages in ``site`` are installed."""
    path = os.pathsep.join([str(site), str(ROOT)])
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(code)],
        capture_output=True,
        text=True,
        cwd=site,
        env={**os.environ, "PYTHONPATH": path},
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """Return what one process with the example package sees of it, all the way to a report."""
    site = tmp_path_factory.mktemp("site")
    project = tomllib.loads((EXAMPLE / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    install(EXAMPLE / "hpe_example", site, project["entry-points"], project["name"], project["version"])
    return run(
        site,
        """
        import json
        from pathlib import Path
        import numpy as np
        import hpe_rig as hpe
        from hpe_rig.cli.listing import extension_lines
        from hpe_rig.report import write_report
        from hpe_rig.study import one_shot
        from hpe_rig.validation.accuracy.own_scene import UNCHANGED, scene_rows, variants

        law = {"shear_modulus_pa": 5e3, "springpot_modulus_pa": 2e3, "power": 0.5}
        scene = hpe.load_scene("bovine-muscle").with_({
            "processing.estimator": "demodulated",
            "excitation.burst_count": 10,
            "simulation.specimen.medium": "fractional_voigt",
            "simulation.specimen.parameters": law,
        })
        seen = {"lines": extension_lines()[0], "check": str(hpe.check(scene))}
        table_1 = variants(hpe.load_scene("table-1"))
        seen["variants"] = [str(item) for item in table_1 if item.values.get("processing.estimator")]
        tried = [item for item in variants(scene) if item.varied == UNCHANGED or item.setting == "coherent"]
        seen["rows"] = [(row.setting, row.error) for row in scene_rows(one_shot(scene), None, tried, 2)]
        measured = hpe.measure(scene, path="run.h5")
        result = measured.estimate()
        strongest = max(result.shots[0].estimates, key=lambda each: each.amplitude_m)
        seen["estimate"] = [strongest.amplitude_m, strongest.amplitude_uncertainty_m]
        seen["truth"] = strongest.true_amplitude_m
        seen["moduli"] = str(hpe.fit_moduli(measured, laws=["fractional_voigt"]))
        seen["report"] = Path(write_report(Path("run.h5"))).read_text(encoding="utf-8")
        late = np.arange(256) - 8 * np.sin(2 * np.pi * 200 * np.arange(40) / 4000)[:, None] / 100
        noise = np.random.default_rng(1).normal(size=(40, 256))
        samples = np.rint(1000 * np.cos(0.2 * np.pi * late) + 10 * noise).astype("<i2")
        head = json.dumps({"fs": 5e7, "prf": 4000, "fc": 5e6, "samples": 256}).encode()
        Path("rf.bx").write_bytes(head + b"\\n" + samples.tobytes())
        own = '[tracking]\\n[acquisition]\\ngate_depth_m = 2e-3\\n[processing]\\nfrequencies_hz = [200.0]\\n'
        Path("s.toml").write_text('title = "bench X"\\n' + own)
        imported = hpe.import_records("rf.bx", "s.toml", "x.h5")
        seen["of_import"] = Path(write_report(Path("x.h5"))).read_text(encoding="utf-8")
        seen["imported"] = bool((imported.records[0].codes == samples).all()), imported.bench.recording.format
        try:
            Path("bad.bx").write_bytes(b"rubbish")
            hpe.import_records("bad.bx", "s.toml", "y.h5")
        except Exception as error:
            seen["refused"] = str(error)
        print(json.dumps(seen))
        """,
    )


@pytest.mark.slow
def test_what_a_package_brings_is_listed_with_its_version(found: Any) -> None:
    assert found["lines"] == [
        "demodulated (hpe_rig.estimators, of hpe-example 1.0)",
        "fractional_voigt (hpe_rig.media, of hpe-example 1.0)",
        "bench_x (hpe_rig.importers, of hpe-example 1.0)",
    ]


@pytest.mark.slow
def test_an_installed_estimator_is_predicted_measured_and_compared_like_ours(found: Any) -> None:
    assert re.search(r"^ +demodulated +-?[0-9.]+ nm", found["check"], flags=re.MULTILINE)
    assert (
        "of other packages: demodulated (hpe_rig.estimators, of hpe-example 1.0), fractional_voigt (" in found["check"]
    )
    assert any("demodulated" in way for way in found["variants"])
    # Both ways of the same records of the foreign medium: a few per cent of its true amplitudes, of which 2 seeds tell.
    assert [setting for setting, _ in found["rows"]] == ["demodulated", "coherent"]
    assert all(0 < error < 0.2 for _, error in found["rows"])
    (amplitude_m, uncertainty_m), true_m = found["estimate"], found["truth"]
    # Three standard uncertainties, and what a prior of Voigt media makes of a medium that is none.
    assert abs(amplitude_m - true_m) < 3 * uncertainty_m + 0.05 * true_m
    assert "demodulated (hpe_rig.estimators, of hpe-example 1.0)" in found["report"]


@pytest.mark.slow
def test_an_installed_medium_moves_the_twin_and_is_fitted(found: Any) -> None:
    value, u = map(float, re.findall(r"power p ([0-9.]+) \+- ([0-9.]+)", found["moduli"])[0])
    assert "Fractional Voigt, probability" in found["moduli"]
    assert abs(value - 0.5) < 3 * u < 0.3
    assert "<dt>simulated medium</dt><dd>fractional_voigt (hpe_rig.media, of hpe-example 1.0)</dd>" in found["report"]


@pytest.mark.slow
def test_an_installed_importer_reads_its_files_and_names_itself_where_it_cannot(found: Any) -> None:
    assert found["imported"] == [True, "bench_x"]
    assert "rf.bx, format bench_x (hpe_rig.importers, of hpe-example 1.0)" in found["of_import"]
    assert "importer bench_x (hpe_rig.importers, of hpe-example 1.0): this is not a file of bench X" in found["refused"]


BROKEN = {
    "hpe_rig.estimators": {
        "raises": "broken:RAISES",
        "shapes": "broken:SHAPES",
        "absent": "broken:NOTHING",
        "leaves": "broken:LEAVES",
        "negative": "broken:NEGATIVE",
        "huge": "broken:HUGE",
        "moved": "broken:MOVED",
    },
    "hpe_rig.media": {"slopes": "broken:SLOPES", "number": "broken:NUMBER"},
    "hpe_rig.importers": {"gives": "broken:GIVES"},
}
CODE = """
import sys
import numpy as np
from hpe_rig.medium import Law, Parameter
from hpe_rig.processing import EstimatorSpec, Motion

def fails(echoes):
    raise KeyError("lost")

def short(echoes):
    return Motion(echoes.pulse_time_s, np.zeros(3), np.zeros(3), echoes.valid)

def leaves(echoes):
    sys.exit(0)

def constant(displacement_m, variance_m2, late_s=0.0):
    def motion(echoes):
        shape = echoes.volts.shape[:-1]
        time_s = echoes.pulse_time_s + late_s
        return Motion(time_s, np.full(shape, displacement_m), np.full(shape, variance_m2), echoes.valid)
    return motion

LEAVES = EstimatorSpec("leaves", leaves)
NEGATIVE = EstimatorSpec("negative", constant(1e-6, -1e-18))
HUGE = EstimatorSpec("huge", constant(1e300, 1e-18))
MOVED = EstimatorSpec("moved", constant(1e-6, 1e-18, 1.0))

class GIVES:
    suffixes = (".gv",)
    def read(self, path, settings):
        return 7

RAISES, SHAPES, NUMBER = EstimatorSpec("raises", fails), EstimatorSpec("shapes", short), 7
SLOPES = Law("slopes", (Parameter.linear("p", (0.0, 1.0), (0.5,)),), lambda s, v: (s * v, 9 * s[:, None] + 0 * v))
"""


def test_an_extension_that_fails_names_itself_and_costs_no_other(tmp_path: Path) -> None:
    source = tmp_path / "source" / "broken"
    source.mkdir(parents=True)
    (source / "__init__.py").write_text(CODE, encoding="utf-8")
    site = tmp_path / "site"
    site.mkdir()
    install(source, site, BROKEN, "broken", "0.1")
    said = run(
        site,
        """
        import json
        from pathlib import Path
        import numpy as np
        import hpe_rig as hpe
        from hpe_rig.cli.listing import extension_lines

        lines, sound = extension_lines()
        def message(call):
            try:
                call()
            except Exception as error:
                return f"{type(error).__name__}: {error}"
        rf = np.random.default_rng(1).normal(size=(40, 64))
        known = dict(sample_rate_hz=5e7, pulse_rate_hz=4e3, carrier_hz=5e6, frequencies_hz=[200.0])
        names = "raises", "shapes", "absent", "leaves", "negative", "huge", "moved"
        said = {name: message(lambda: hpe.estimate(rf, estimator=name, **known)) for name in names}
        Path("a.gv").write_bytes(b"12345678")
        said["gives"] = message(lambda: hpe.import_records("a.gv", "table-1", "x.h5"))
        specimen = {"simulation.specimen.medium": "number", "simulation.specimen.parameters": {"p": 1.0}}
        muscle = hpe.load_scene("bovine-muscle")
        said["number"] = message(lambda: hpe.check(muscle.with_(specimen)))
        fine = hpe.estimate(np.cos(0.6 * np.arange(64))[None] * np.ones((40, 1)) + 1e-3 * rf, **known)
        print(json.dumps({"lines": lines, "sound": sound, "said": said, "fine": len(fine.shots)}))
        """,
    )
    assert not said["sound"]
    whose = {name: f"{name} ({group}, of broken 0.1)" for group, points in BROKEN.items() for name in points}
    for name in ("raises", "shapes", "absent", "gives", "number", "leaves", "negative", "huge", "moved"):
        assert whose[name] in said["said"][name], said["said"][name]
    assert "KeyError" in said["said"]["raises"]
    assert "tried to end the program (SystemExit: 0)" in said["said"]["leaves"]
    assert "a variance of displacement_m that is negative" in said["said"]["negative"]
    assert "displacement_m up to 1e+300, more than 10" in said["said"]["huge"]
    assert "other pulses than those of the echoes" in said["said"]["moved"]
    for name in ("absent", "slopes", "number"):
        assert any(line.startswith("FAILS") and whose[name] in line for line in said["lines"])
    assert said["fine"] == 1
