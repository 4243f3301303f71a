"""Commands on benches: ``bench``, ``commission``, ``emulate``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hpe_rig.cli.console import EXIT_INSTRUMENT, guarded, printing
from hpe_rig.cli.options import BenchPath, Json, output_option
from hpe_rig.cli.streams import results_accepted

DEFAULT_SCENE = "bovine-muscle"

benches = typer.Typer()


@benches.command("bench")
@guarded
@printing
def bench_command(
    bench: Annotated[
        Path | None, typer.Argument(metavar="BENCH.toml", help="Bench file or run file. Default: the simulated bench.")
    ] = None,
    compare: Annotated[
        Path | None, typer.Option(metavar="RUN.h5", help="Run file. Print how its bench differs from this one.")
    ] = None,
    self_test: Annotated[
        bool, typer.Option("--self-test", help="Also run each generator's self-test, outputs off.")
    ] = False,
    off: Annotated[
        bool,
        typer.Option(
            "--off", help="Only switch every output off and verify it, even if another program uses the bench."
        ),
    ] = False,
    identify: Annotated[
        bool,
        typer.Option("--identify", help="Show each role on its instrument, ask, and write serial numbers to BENCH."),
    ] = False,
    wide: Annotated[bool, typer.Option("--wide", help="Print every column.")] = False,
    json: Json = False,
) -> None:
    """Identify every instrument, read its settings, leave outputs off. Or compare with the bench of a run."""
    from hpe_rig.scene import Mistake, SettingsError

    # A run file describes a bench that may no longer exist: nothing can be switched or tested.
    is_run_file = bench is not None and bench.suffix == ".h5"
    if json and (off or identify or compare is not None):
        what = "it prints the state of a bench, without --off, --identify and --compare"
        raise SettingsError("--json", [Mistake("", what, "hpe-rig bench BENCH.toml --json")])
    if off:
        if compare is not None or self_test or identify or is_run_file:
            what = "it only switches the instruments of a bench file off"
            raise SettingsError("--off", [Mistake("", what, "hpe-rig bench BENCH.toml --off")])
        from hpe_rig.cli.off import switch_all_off

        raise typer.Exit(switch_all_off(bench))
    if identify:
        from hpe_rig.cli.identify import identify as identify_instruments

        if compare is not None or self_test:
            mistake = Mistake("", "it only writes serial numbers into a bench file", "hpe-rig bench BENCH --identify")
            raise SettingsError("--identify", [mistake])
        raise typer.Exit(identify_instruments(bench))
    if bench is not None and is_run_file and (self_test or compare is None):
        what = "a run file records a bench but gives no access to its instruments"
        raise SettingsError(bench.name, [Mistake("", what, "a bench file, or --compare RUN.h5 alone")])
    _show_bench(bench, compare, self_test=self_test, wide=wide, json=json)


def _show_bench(bench: Path | None, compare: Path | None, *, self_test: bool, wide: bool, json: bool) -> None:
    """Print the state of a bench and its comparison; exit with a code if an instrument is not ready."""
    from hpe_rig.cli.bench import (
        bench_state,
        compare_with,
        print_calibration,
        print_conditions,
        print_report,
        report_json,
    )

    state = bench_state(bench, self_test)
    ready = True
    if json and state.report is not None and state.bench is not None:
        ready = report_json(state.report, state.bench)
    elif state.report is not None and state.bench is not None:
        print_report(state.report, wide)
        ready = print_conditions(state.bench) and state.report.complete
        print_calibration(state.bench)
    if compare is not None:
        typer.echo(compare_with(compare, state))
    if not ready:
        raise typer.Exit(EXIT_INSTRUMENT)


@benches.command("commission")
@guarded
def commission_command(
    bench: Annotated[
        Path | None, typer.Argument(metavar="BENCH.toml", help="Bench file. Default: the simulated bench.")
    ] = None,
) -> None:
    """Drive every cable with the amplifier off, find it at the digitizer, write its delay into the bench file."""
    from hpe_rig.cli.commission import commission_bench

    raise typer.Exit(commission_bench(bench))


@benches.command()
@guarded
def emulate(
    bench_or_scene: Annotated[
        str,
        typer.Argument(
            metavar="BENCH.toml|SCENE",
            help="Bench file to emulate, real or simulated; or a scene, for the simulated bench or that of --bench.",
        ),
    ] = DEFAULT_SCENE,
    bench: BenchPath = None,
    transport: Annotated[
        str, typer.Option(metavar="NAME", help="One of socket, serial, hislip, vxi11, prologix.")
    ] = "socket",
    output: Annotated[
        Path | None, output_option("Bench file with the addresses that are served, .toml. Default: it is printed.")
    ] = None,
) -> None:
    """Serve the simulated generators of a bench to any VISA program. On loopback; stop with Ctrl-C."""
    from hpe_rig.bench import emulate as serve, is_bench_file
    from hpe_rig.measurement import prepare
    from hpe_rig.scene import Mistake, SettingsError
    from hpe_rig.store import write_file

    if bench is None and Path(bench_or_scene).suffix == ".toml" and not Path(bench_or_scene).exists():
        what = f"there is no file {bench_or_scene}"
        remedy = "the path of a bench file or a scene, or a name that hpe-rig scenes lists"
        raise SettingsError("command line", [Mistake("BENCH.toml|SCENE", what, remedy)])
    scene = bench_or_scene
    if is_bench_file(bench_or_scene):
        if bench is not None:
            what = f"{bench_or_scene} is a bench file too"
            raise SettingsError("command line", [Mistake("--bench", what, "one of the two")])
        scene, bench = DEFAULT_SCENE, Path(bench_or_scene)
    setup = prepare(scene, bench, refuse=False)

    def announce_addresses(text: str) -> None:
        if output is None:
            typer.echo(text)
        else:
            write_file(output, text, overwrite=False)
            typer.echo(f"{output}: bench file of the generators served until Ctrl-C; rehearse with it:")
            typer.echo(f"  hpe-rig bench {output}\n  hpe-rig commission {output}\n  hpe-rig run SCENE --bench {output}")
        # Without its addresses the bench is of no use. The end of the program states the cause.
        if not results_accepted():
            raise typer.Exit(EXIT_INSTRUMENT)

    serve(setup.scene.scene, setup.bench, transport, announce_addresses)
