"""Reproduction of the paper: each number and stated trend of the paper against what comes out, in every reading."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from hpe_rig.report import PageSection, page_table
from hpe_rig.study import StudyResult
from hpe_rig.validation.paper import claims
from hpe_rig.validation.paper.judgement import ABSENT, AGREES, Judge, flat, judged, slight, trend

READINGS = ("physical", "literal", "as_printed", "one_draw")
WORDS = {"physical": "physically", "literal": "literally", "as_printed": "as printed", "one_draw": "with one draw"}
"""How a reading is said in a sentence."""


@dataclass(frozen=True, slots=True)
class Claim:
    """One statement: where it stands, what it says, which study tells, how it is judged.

    ``physical``, ``literal`` (also as printed) and ``both`` say why it is missed in a reading; shown only where it is.
    """

    where: str
    says: str
    study: str
    judge: Judge
    physical: str = ""
    literal: str = ""
    both: str = ""


def rows(results: Mapping[str, StudyResult]) -> list[dict[str, str]]:
    """Return a row a claim, for studies by name; readings that were not run say so."""
    out = []
    for claim in CLAIMS:
        row, why = {"where": claim.where, "the paper": claim.says}, dict[str, list[str]]()
        for reading in READINGS:
            one = judged(results, claim.study, reading, claim.judge)
            row |= {reading: one.found, f"verdict, {reading}": one.verdict}
            own = {"physical": claim.physical, "one_draw": ONE_DRAW}.get(reading, claim.literal)
            reason = claim.both or own
            if reason and one.verdict not in (AGREES, ABSENT):
                why.setdefault(reason, []).append(reading.replace("_", " "))
        out.append({**row, "why": "; ".join(f"{' and '.join(names)}: {text}" for text, names in why.items())})
    return out


def reproduction_part(results: Sequence[StudyResult]) -> PageSection | None:
    """Return the paper's statements against these studies; None where they tell nothing about any."""
    found = rows({one.name: one for one in results})
    told = [row for row in found if not all(row[f"verdict, {name}"] == ABSENT for name in READINGS)]
    if not told:
        return None
    absent = _not_run(told)
    told = [{name: text for name, text in row.items() if name not in absent} for row in told]
    words = [
        "Each number and each stated trend of the paper against what comes out of the paper's own chain. Agrees: a "
        "number within its rounding and three standard errors; a trend significant (three standard errors) at 0, 20 "
        "and 40 dB. In part: at some of them. Inconclusive: neither it nor its absence shows. What is said of a "
        "largest value is judged by how far chance lifts the largest of so many. A miss is shown as a miss.",
    ]
    if len(told) < len(found):
        rest = len(found) - len(told)
        words.append(f"{rest} statements need other studies: hpe-rig study reproduction has them all.")
    shown = page_table("reproduction", "Reproduction of the paper.", told, folded=False)
    return PageSection("reproduction-section", "Reproduction", tuple(words), (), (shown,), _headline(told))


def _not_run(told: Sequence[Mapping[str, str]]) -> set[str]:
    """Return the columns of readings that no study was run in."""
    absent = [name for name in READINGS if all(row[f"verdict, {name}"] == ABSENT for row in told)]
    return {column for name in absent for column in (name, f"verdict, {name}")}


def _headline(told: Sequence[Mapping[str, str]]) -> str:
    """Return how many statements agree in each reading that was run."""
    parts = []
    for name in READINGS:
        verdicts = [verdict for row in told if (verdict := row.get(f"verdict, {name}", ABSENT)) != ABSENT]
        if verdicts:
            parts.append(f"{verdicts.count(AGREES)} of {len(verdicts)} read {WORDS[name]}")
    return f"Statements of the paper that agree with what comes out: {', '.join(parts)}."


SPECKLE = (
    "scatterers at their own depths make speckle: the mean weights by intensity and is larger, and where an echo fades "
    "the estimate scatters far more than a coherent sum does"
)
ONE_DRAW = (
    "the speckle of one draw is in every number and no deviation: another draw has another bias, by 6 to 8 % of the "
    "displacement"
)
RESOLVED = (
    "above 20 dB the jitter is speckle, and a shorter pulse finds more independent speckles in the gate; below, it "
    "takes in more noise"
)

CLAIMS: tuple[Claim, ...] = (
    Claim("Sec. V.A", "error at high SNR 18.5 %", "fig-4",
          claims.at_highest_snr("bias", 18.5, 0.05, -100, unit=" %"), physical=SPECKLE),
    Claim("Sec. V.A", "error's deviation at high SNR 3.4 %", "fig-4",
          claims.at_highest_snr("jitter", 3.4, 0.05, 100, unit=" %"), physical=SPECKLE,
          literal="how many scatterers the gate holds is not said: eleven in an ellipsoid of -6 dB (here), or eleven "
          "in a box of the FWHM, half as many (3.6 %)"),
    Claim("Sec. V.A", "tracked over peak displacement 0.815", "fig-4",
          claims.at_highest_snr("bias", 0.815, 0.0005, offset=1.0), physical=SPECKLE),
    Claim("Sec. IV.A", "about 0.82 at W_x = W_y = 2.19", "fig-12", claims.map_ratio,
          physical=f"{SPECKLE}; interpolation between eleven points a side loses 0.007, the rest is chance"),
    Claim("Fig. 4", "displacement levels out as SNR increases", "fig-4", claims.levels_out),
    Claim("Fig. 4", "no bias of the phase", "fig-4", claims.no_phase_bias),
    Claim("Sec. V.A", "errors reduced significantly for SNR of 20 dB and more", "fig-4", claims.falls_by_20_db),
    Claim("Sec. V.A", "100 realisations very similar to 1000", "fig-4", claims.hundred),
    Claim("Fig. 5", "displacement bias decreases as D_0 decreases", "fig-5", trend("amplitude_bias", falls=False)),
    Claim("Fig. 5", "displacement jitter decreases as D_0 decreases", "fig-5", trend("amplitude_jitter", falls=False)),
    Claim("Fig. 5", "phase bias decreases as D_0 increases", "fig-5", trend("phase_bias", falls=True),
          both="none is left to fall: the half pulse interval and the 90 degrees of a difference of pulses are taken "
          "off"),
    Claim("Fig. 5", "phase jitter decreases as D_0 increases", "fig-5", trend("phase_jitter", falls=True)),
    Claim("Fig. 6", "displacement jitter decreases as N_c increases", "fig-6", trend("amplitude_jitter", falls=True)),
    Claim("Fig. 6", "phase jitter decreases as N_c increases", "fig-6", trend("phase_jitter", falls=True)),
    Claim("Fig. 6", "displacement bias not affected significantly by N_c", "fig-6", flat("amplitude_bias", 10.0),
          both="at 0 dB noise alone makes an amplitude, the smaller the more cycles"),
    Claim("Fig. 6", "phase bias not affected significantly by N_c", "fig-6", flat("phase_bias", 1.0)),
    Claim("Fig. 7", "displacement bias decreases as N_p increases", "fig-7", trend("amplitude_bias", falls=True),
          both="at 0 dB noise makes it; at 20 and 40 dB the gain sinc(f_v/f_prf) of a difference of pulses, 0.94 at "
          "N_p = 5, does where it is left in"),
    Claim("Fig. 7", "displacement jitter decreases as N_p increases", "fig-7", trend("amplitude_jitter", falls=True)),
    Claim("Fig. 7", "phase jitter decreases as N_p increases", "fig-7", trend("phase_jitter", falls=True)),
    Claim("Fig. 7", "minimal effects of N_p on the phase bias", "fig-7", flat("phase_bias", 1.0)),
    Claim("Fig. 8", "displacement error decreases with N_s", "fig-8", trend("amplitude_jitter", falls=True),
          physical="from eleven on speckle is fully developed: more scatterers make the same speckle"),
    Claim("Fig. 8", "phase error decreases with N_s", "fig-8", trend("phase_jitter", falls=True),
          both="noise makes it, and its level is that of the SNR, for any N_s"),
    Claim("Fig. 8", "the variation with N_s is fairly small", "fig-8", slight("amplitude_jitter", 0.2),
          literal="at high SNR the jitter is that of a mean over the gate's scatterers and goes with 1/sqrt(N_s)"),
    Claim("Fig. 9", "a longer gate improves the displacement: its bias", "fig-9", trend("amplitude_bias", falls=True),
          both="a longer gate holds what lies farther from the focal plane and moves less; its jitter falls"),
    Claim("Fig. 9", "a longer gate improves the displacement: its jitter", "fig-9",
          trend("amplitude_jitter", falls=True)),
    Claim("Fig. 9", "a longer gate improves the phase", "fig-9", trend("phase_jitter", falls=True)),
    Claim("Fig. 10", "displacement jitter decreases with F_s", "fig-10", trend("amplitude_jitter", falls=True)),
    Claim("Fig. 10", "phase jitter decreases with F_s", "fig-10", trend("phase_jitter", falls=True)),
    Claim("Fig. 11", "displacement error increases with BW", "fig-11", trend("amplitude_jitter", falls=False),
          physical=RESOLVED),
    Claim("Fig. 11", "phase error increases with BW", "fig-11", trend("phase_jitter", falls=False)),
    Claim("Fig. 11", "displacement jitter changes significantly only at low SNR", "fig-11",
          flat("amplitude_jitter", 5.0, from_db=30.0), physical=RESOLVED),
    Claim("Fig. 12", "displacement increases with W_x and W_y", "fig-12",
          claims.map_trend("amplitude_bias", falls=True)),
    Claim("Fig. 12", "displacement jitter decreases with W_x and W_y", "fig-12",
          claims.map_trend("amplitude_jitter", falls=True),
          both="below W = 0.6 next to nothing moves, so next to nothing scatters"),
    Claim("Fig. 12", "phase bias decreases with W_x and W_y", "fig-12", claims.map_trend("phase_bias", falls=True),
          literal="at W = 0.1 next to nothing moves: its phase is chance"),
    Claim("Fig. 12", "phase jitter decreases with W_x and W_y", "fig-12", claims.map_trend("phase_jitter", falls=True)),
    Claim("Fig. 12", "phase bias below 5 degrees for W_x, W_y > 0.5", "fig-12", claims.phase_limit("phase_bias"),
          physical=SPECKLE),
    Claim("Fig. 12", "phase jitter below 5 degrees for W_x, W_y > 0.5", "fig-12", claims.phase_limit("phase_jitter"),
          physical=SPECKLE),
    Claim("Fig. 13", "differences up to and above 0.5 at W_z = 0.1", "fig-13",
          claims.difference_at(0, 0.5, and_more=True)),
    Claim("Fig. 13", "differences decrease as W_z increases", "fig-13", claims.differences_fall),
    Claim("Fig. 13", "differences still as high as 0.15 at W_z = 2.18", "fig-13", claims.difference_at(-1, 0.15)),
    Claim("Sec. V.A", "phase jitter about constant for W_z of 0.5 and more", "fig-13", claims.phase_over_w_z),
    Claim("Sec. V.A", "no significant change for W_z = 5 and 10", "w-z", claims.wider_axially),
)  # fmt: skip
