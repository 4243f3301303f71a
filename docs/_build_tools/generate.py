"""Pages of the reference that every build generates from the program.

Settings come from the schemas that validate them, commands from their ``--help``, names from their docstrings, and
messages from provoking them (``messages.py``).
"""

from __future__ import annotations

import importlib
import inspect
import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import command_tree
import messages

from hpe_rig.scene.description import DescribedKey

EXAMPLES = {
    "sweep.axes": '{"tracking.delay_s" = [0.0, 1e-4]}',
    "acquisition.shot_period_s": "1.5",
    "beams.focus_depth_m": "70e-3",
    "digitizer.acquisition_mode": '"npt"',
    "generators.amplitude_vpp": "1.0",
    "recording.source": '"echoes.npy"',
    "recording.sha256": '"9f86d081..."',
    "recording.format": '"npy"',
    "recording.first_sample_s": "80e-6",
    "recording.inferred": '["pulse_rate_hz, from the file"]',
    "medium.shear_modulus_pa": "9e3",
    "notes": '{ operator = "initials", temperature_c = 21.5 }',
    "medium.shear_viscosity_pa_s": "2.0",
    "sweep.axial_offset_m": "[-2e-3, 0.0, 2e-3]",
    "simulation.receive_chain.notch.centre_hz": "3e6",
    "simulation.receive_chain.notch.bandwidth": "0.5",
    "simulation.receive_chain.band_pass.centre_hz": "9e6",
    "simulation.receive_chain.band_pass.bandwidth": "0.33",
    "simulation.receive_chain.second_band_pass.centre_hz": "9e6",
    "simulation.receive_chain.second_band_pass.bandwidth": "0.33",
    "digitizer.library": '"/usr/local/lib/libATSApi.so"',
    "digitizer.monitor_range_v": "4.0",
    "generators.address": '"GPIB0::10::INSTR"',
    "generators.interface": '"PRLGX-TCPIP0::192.168.1.20::1234::INTFC"',
    "generators.max_vpp": "2.0",
    "generators.clock_accuracy": "5e-6",
    "digitizer.clock_accuracy": "6e-6",
    "generators.serial": '"MY44000123"',
    "generators.carrier_band_hz": "[2.5e6, 3.5e6]",
    "digitizer.serial": '"970123"',
    "wiring.delay_u_s": "3e-9",
    "commissioning.date": "2026-03-05",
    "commissioning.program": '"hpe-rig 1.0"',
    "commissioning.digest": '"0f3a9c1b2d4e5f60"',
    "commissioning.cables": '["master.output to burst_train.trigger"]',
    "conditions.name": '"water_temperature"',
    "conditions.unit": '"degC"',
    "conditions.command": '["python", "thermometer.py", "--port", "COM5"]',
    "conditions.plugin": '"thermometer"',
    "conditions.min": "19.0",
    "conditions.max": "22.0",
    "calibration.date": "2026-03-05",
    "calibration.who": '"name"',
    "calibration.u": "0.1",
    "calibration.valid_until": "2027-03-05",
    "beams.push_focus_depth_m": "70e-3",
    "transducers.push.focus_depth_m": "70e-3",
    "transducers.push.width_m": "[0.34e-3, 0.34e-3, 3.60e-3]",
    "transducers.tracking.diameter_m": "20e-3",
    "transducers.tracking.focus_depth_m": "40e-3",
    "transducers.tracking.pulse_length_m": "1.32e-3",
    "transducers.tracking.width_m": "[0.078e-3, 0.078e-3, 0.83e-3]",
    "simulation.beams.tracking_focus_depth_m": "40e-3",
    "simulation.instruments.trigger_faults.lost": "[0, 17]",
    "simulation.instruments.trigger_faults.stray_s": "[10.1e-3]",
    "simulation.instruments.trigger_faults.frozen_stamps": "[100, 200]",
    "simulation.instruments.trigger_faults.stamp_jumps.record": "312",
    "simulation.instruments.trigger_faults.stamp_jumps.jump_s": "0.25",
    "processing.expected_amplitude_m": "500e-9",
    "processing.expected_snr_db": "40.0",
    "processing.frequency_accuracy": "5e-6",
    "processing.gate_profile_step_m": "0.5e-3",
    "processing.gates.depth_m": "70.5e-3",
    "processing.gates.length_m": "0.8e-3",
    "beams.excitation_scan": '"push.csv"',
    "simulation.beams.excitation_scan": '"push.h5"',
    "simulation.beams.tracking_scan": '"tracking.h5"',
    "processing.harmonic": '"least_squares"',
    "processing.reference_gate_depth_m": "66e-3",
    "processing.reference_gate_length_m": "1e-3",
    "simulation.beams.width_ratio": "[2.2, 2.2, inf]",
    "simulation.receive_chain.noise_v_per_sqrt_hz": "2e-9",
    "simulation.receive_chain.preset": '"paper"',
    "simulation.receive_chain.recovery_time_s": "5e-6",
    "simulation.scatterers.echo_tolerance": "1e-3",
    "simulation.specimen.preset": '"gelatin_8"',
    "simulation.specimen.depth_m": "12.5e-3",
    "title": '"Gelatin, 100 us at 200 Hz"',
    "tracking.pulse_count": "800",
    "transport": '"socket"',
}
"""Examples of keys that have no default and are set in no shipped file."""
PURPOSE = {
    "scene": "A scene states what is measured and on which specimen. `hpe-rig new my-scene --full` writes one with "
    "every key below as a comment.",
    "bench": "A bench file states the instruments, their addresses, their wiring and the limits that must not be "
    "exceeded. `hpe-rig new my-bench --like bench --full` writes one with every key below as a comment.",
    "simulation": "Settings of the digital twin: the section `[simulation]` of a scene. A real bench ignores them.",
}
ROOT = Path(__file__).parents[2]
PACKAGES = tuple(
    ".".join(stub.parent.relative_to(ROOT).parts)
    for package in ("hpe_rig", "drivers", "sim_backend")
    for stub in sorted((ROOT / package).glob("*/__init__.pyi"))
)
"""Packages with a public interface."""


def pages() -> dict[str, str]:
    """Return the generated pages, Markdown by file name."""
    settings = {f"{subject}.md": settings_page(subject) for subject in PURPOSE}
    return {
        **settings,
        "commands.md": commands_page(),
        "api.md": api_page(),
        "packages.md": packages_page(),
        "messages.md": messages.markdown(),
        "command-tree.md": command_tree.page(),
    }


def write_pages(folder: Path) -> None:
    """Write the generated pages into ``folder``; unchanged pages keep their time stamp and are not rebuilt."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in pages().items():
        path = folder / name
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")


def settings_page(subject: str) -> str:
    """Return the page with every key of a ``"scene"``, a ``"bench"`` file or ``"simulation"``, from the schema."""
    from hpe_rig.runs import settings_tables

    title = "[simulation]" if subject == "simulation" else f"a {subject}"
    lines = [f"# Keys of {title}", "", PURPOSE[subject], ""]
    lines += [
        "Every number is in the SI unit at the end of its key. Unknown keys and values out of bounds are refused",
        "before anything is opened; the message names the key and a remedy.",
        "",
    ]
    shipped = _shipped_values(subject)
    for table in settings_tables(subject):
        name = ".".join(table.path)
        if name:
            lines += [f"## {table.header}", "", f"{table.text} *({'required' if table.required else 'optional'})*", ""]
        if table.keys:
            lines += ["| key | meaning | value | default | example |", "|---|---|---|---|---|"]
            lines += [_key_row(key, f"{name}.{key.name}" if name else key.name, shipped) for key in table.keys]
            lines.append("")
    return "\n".join(lines)


def _key_row(key: DescribedKey, path: str, shipped: Mapping[str, Any]) -> str:
    """Return the row of one key in the table of its section."""
    default = "**required**" if key.required else f"`{key.default}`" if key.default else "absent"
    unit, bounds = f" in {key.unit}" if key.unit else "", f", {key.bounds}" if key.bounds else ""
    example = _example_value(key, path, shipped)
    row = (f"`{key.name}`", key.text, f"{key.kind}{unit}{bounds}", default, f"`{example}`" if example else "")
    return f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in row)} |"


def _example_value(key: DescribedKey, path: str, shipped: Mapping[str, Any]) -> str | None:
    """Return an example in TOML: from a shipped file, else the default, else from ``EXAMPLES``."""
    from hpe_rig.scene.description import toml_value

    listed = EXAMPLES.get(_without_role(path))
    value = None if path == "title" else shipped.get(path)
    example = toml_value(value) if value is not None else key.default or listed
    if example in (None, "[]"):
        # An empty list shows no syntax, but it is better than no example.
        example = listed if listed is not None else key.default
    return example


def _without_role(path: str) -> str:
    """Return the path of a generator's key without the role of the generator: all generators have the same keys."""
    first, *inner = path.split(".")
    return f"generators.{inner[-1]}" if first == "generators" else path


def _shipped_values(subject: str) -> dict[str, Any]:
    """Return the values set in shipped files, by path; the first file in alphabetical order determines a value."""
    from hpe_rig.bench import read_bench
    from hpe_rig.scene import shipped_scenes

    texts = [read_bench().text] if subject == "bench" else list(shipped_scenes().values())
    values: dict[str, Any] = {}
    for text in texts:
        for path, value in _flattened(tomllib.loads(text)):
            values.setdefault(path, value)
    return values


def _flattened(table: Mapping[str, Any], path: str = "") -> Iterator[tuple[str, Any]]:
    """Yield (dotted path, value) of every key in nested tables; of an array of tables only the first is used."""
    for key, value in table.items():
        key_path = f"{path}.{key}" if path else key
        if isinstance(value, Mapping):
            yield from _flattened(value, key_path)
        elif isinstance(value, list) and value and isinstance(value[0], Mapping):
            yield from _flattened(value[0], key_path)
        else:
            yield key_path, value


def commands_page() -> str:
    """Return the page with the help of every command."""
    exit_codes = "[Exit codes](../../how-to/troubleshooting.md#exit-codes)"
    lines = ["# Commands", "", f"`hpe-rig COMMAND --help` prints the same. {exit_codes}.", ""]
    for words in command_names():
        lines += [f"## hpe-rig {' '.join(words)}".rstrip(), "", "```text", _help(words), "```", ""]
    return "\n".join(lines) + "\n"


def command_names() -> list[tuple[str, ...]]:
    """Return the words of every command, the program itself first: ``()``, ``("run",)``, ..."""
    import typer

    from hpe_rig.cli import commands

    return list(_command_words(typer.main.get_command(commands)))


def _command_words(command: Any, words: tuple[str, ...] = ()) -> Iterator[tuple[str, ...]]:
    yield words
    for name, inner in getattr(command, "commands", {}).items():
        if not inner.hidden:
            yield from _command_words(inner, (*words, name))


def _help(words: tuple[str, ...]) -> str:
    from typer.testing import CliRunner

    from hpe_rig.cli import commands

    environment = {"COLUMNS": "100", "TERMINAL_WIDTH": "100"}
    done = CliRunner().invoke(commands, [*words, "--help"], env=environment, prog_name="hpe-rig")
    return done.stdout.strip("\n")


def api_page() -> str:
    """Return the page of the public API, from the docstrings."""
    import hpe_rig

    lines = ["# Python API", "", "`import hpe_rig as hpe` offers the names on this page, each loaded on first use.", ""]
    lines += ["```python", *_example_code(hpe_rig.__doc__ or ""), "```", ""]
    lines += ["A scene may be given as a name, a path or a `Scene`.", "", "```{eval-rst}"]
    for name in sorted(hpe_rig.__all__, key=lambda name: (inspect.isclass(getattr(hpe_rig, name)), name)):
        if inspect.isclass(getattr(hpe_rig, name)):
            lines += [f".. autoclass:: hpe_rig.{name}", "   :members:", "   :exclude-members: model_config", ""]
        else:
            lines += [f".. autofunction:: hpe_rig.{name}", ""]
    return "\n".join([*lines, "```", ""])


def _example_code(docstring: str) -> list[str]:
    from doctest import DocTestParser

    return [example.source.rstrip() for example in DocTestParser().get_examples(docstring)]


def packages_page() -> str:
    """Return the page with the public names of every package and the first sentence of their docstrings."""
    lines = [
        "# Public names of the packages",
        "",
        "The names that each package offers to the others. Scripts need only",
    ]
    lines += ["[the public API](api.md); the names below may change from one release to the next.", ""]
    for package in PACKAGES:
        module = importlib.import_module(package)
        lines += [f"## {package}", "", _first_sentence(module.__doc__ or ""), "", "| name | meaning |", "|---|---|"]
        lines += [f"| `{name}` | {text} |" for name, text in described_names(module)]
        lines.append("")
    return "\n".join(lines)


def described_names(module: Any) -> list[tuple[str, str]]:
    """Return the public names of a package, each with the first sentence of its docstring; a constant with its type."""
    names = []
    for name in sorted(module.__all__):
        value = getattr(module, name)
        has_docstring = inspect.isclass(value) or inspect.isroutine(value)
        text = _first_sentence(inspect.getdoc(value) or "") if has_docstring else f"constant, {type(value).__name__}"
        names.append((name, text))
    return names


def _first_sentence(text: str) -> str:
    paragraph = " ".join(text.split("\n\n")[0].split()).replace("``", "`").replace("|", "\\|")
    return paragraph.partition(". ")[0].removesuffix(".") + "."
