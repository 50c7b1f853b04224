"""What single strokes say for or against effects that mean strokes hardly show, and how it joins the evidence of those.

How strokes bear on an effect the effect says itself (`modeling.effects.strokes`): a wave along the feed path, or a
trend over blade life and from trial to trial.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from sawbench.diagnosis.inference.evidence import Explanation
from sawbench.diagnosis.inference.hypothesis import Hypothesis
from sawbench.diagnosis.inference.settings import Settings, Strokes
from sawbench.diagnosis.inference.shared_course import shared_course
from sawbench.diagnosis.inference.stroke_series import StrokeSeries, StrokeSpectra
from sawbench.diagnosis.inference.stroke_trend import NOTHING_SHOWN, blocks_of, trend_evidence
from sawbench.diagnosis.inference.zero_wander import ZeroWander
from sawbench.modeling.effects.effect import Effect
from sawbench.modeling.effects.known import KnownEffect
from sawbench.modeling.effects.strokes import StrokeTrend, StrokeWave, ZeroTrend
from sawbench.modeling.state import State

WAVE_IN_TIME = "cutting coefficient that oscillates in time, not along the feed"
SHARED_COURSE = "cutting coefficient that rises or falls after the start of every trial alike"


@dataclass(frozen=True, kw_only=True, slots=True)
class StrokesSay:
    """What single strokes say of one effect.

    Attributes
    ----------
    effect : Effect
    alone : float
        Log evidence of the strokes where nothing else makes the cut harder or softer.
    beside_cutting : float
        Where another effect may.
    size, size_std : float
        Of the reported parameter; infinite where strokes say whether the effect is there and not how large it is.
    words : str
        What was found, for the report; empty where the size says it all.
    """

    effect: Effect
    alone: float
    beside_cutting: float
    size: float
    size_std: float
    words: str = ""

    @property
    def is_trend(self) -> bool:
        """Whether the effect changes the hardness or the zero over the session; else it is a wave."""
        return not isinstance(self.effect.strokes, StrokeWave)

    def beside(self, others: Sequence[Effect]) -> float:
        """Log evidence of the strokes beside other effects."""
        return self.beside_cutting if any(e.bends_hardness for e in others) else self.alone

    def _is_all_of(self, hypothesis: Hypothesis) -> bool:
        """Whether the effect, in the form that it has in a hypothesis, does nothing but what strokes show."""
        trend = self.effect.strokes
        shapes = [m.column.shape for m in hypothesis.members if m.effect.name == self.effect.name]
        return isinstance(trend, StrokeTrend) and all(trend.is_whole_in(shape) for shape in shapes)

    def joined(self, hypothesis: Hypothesis, rest: float, nats: float, numbers: Strokes) -> float:
        """Log evidence of a hypothesis that holds the effect, by mean strokes and single ones.

        Both know how hard each trial cuts, and single strokes know better what that is worth: wood varies along the
        cut, which in mean strokes looks like a trend. So it counts once.

        Parameters
        ----------
        hypothesis : Hypothesis
            By mean strokes.
        rest : float
            Log evidence without the effect.
        nats : float
            Of the strokes.
        numbers : Strokes
        """
        of_means = hypothesis.log_evidence
        if self._is_all_of(hypothesis):
            return rest + nats
        if self.denies(nats, numbers):
            return min(of_means, rest) + nats
        return max(of_means, rest + nats) if self.is_trend else of_means + nats

    def denies(self, nats: float, numbers: Strokes) -> bool:
        """Whether strokes of that log evidence speak against the effect.

        What mean strokes say for it then comes of something else. A wave is denied where the strokes do not show it:
        mean strokes take the slow changes of the hardness that any wood has for one.
        """
        return nats < numbers.against if self.is_trend else nats <= 0.0


def strokes_say(
    effects: Sequence[Effect],
    states: Sequence[State],
    strokes: Sequence[StrokeSeries],
    settings: Settings,
    known: Sequence[KnownEffect] = (),
) -> tuple[dict[str, StrokesSay], dict[str, float]]:
    """Weigh every effect on which single strokes bear, and what they show that is in no catalogue.

    Parameters
    ----------
    effects : sequence of Effect
    states : sequence of State
        They say how far the blade had cut and how fast it ran.
    strokes : sequence of StrokeSeries
    settings : Settings
    known : sequence of KnownEffect
        What the model holds already of how the hardness changes.

    Returns
    -------
    said : dict of str to StrokesSay
        By effect, waves before trends. Of trials too short to tell a trend, strokes say nothing for one: then nothing
        tells it from uneven wood.
    not_the_woods : dict of str to float
        Log evidence by what it looks like: a wave of the hardness at one frequency in Hz, a course that all trials
        share. Each is one of several looks of "unknown", which share its prior. Where all trials have one feed, a wave
        in time and one in the wood are the same: the catalogue's name is taken for twice as likely. See
        `with_mean_strokes`.
    """
    if not strokes:
        return {}, {}
    long = [one for one in strokes if len(one.log_k) >= settings.strokes.of_wave]
    spectra = StrokeSpectra(long) if long else None
    said: dict[str, StrokesSay] = {}
    for effect in effects:
        if spectra is not None and isinstance(effect.strokes, StrokeWave):
            wave = spectra.wave(effect.strokes)
            said[effect.name] = StrokesSay(
                effect=effect, alone=wave.log_evidence, beside_cutting=wave.log_evidence, size=wave.depth,
                size_std=settings.strokes.depth_std * wave.depth,
                words=effect.strokes.words.format(wavelength_mm=1e3 * wave.wavelength_m),
            )  # fmt: skip
    trends = {e.name: e.strokes for e in effects if isinstance(e.strokes, StrokeTrend)}
    by_name = {e.name: e for e in effects}
    blocks = blocks_of(states, strokes, known)
    found = trend_evidence(blocks, trends, settings.strokes)
    for name in trends:
        trend = found.get(name, NOTHING_SHOWN)
        said[name] = StrokesSay(
            effect=by_name[name], alone=trend.alone, beside_cutting=trend.beside_cutting, size=trend.size,
            size_std=trend.size_std,
        )  # fmt: skip
    in_time = 0.0 if spectra is None else _wave_in_time(spectra, known)
    one_look = math.log(settings.strokes.looks)
    return said, {WAVE_IN_TIME: in_time - one_look - math.log(2.0), SHARED_COURSE: shared_course(blocks) - one_look}


def zeros_say(effects: Sequence[Effect], wander: ZeroWander | None) -> dict[str, StrokesSay]:
    """What return strokes say of a drift of the zero: whether there is one, its size is left to the mean strokes.

    Parameters
    ----------
    effects : sequence of Effect
    wander : ZeroWander or None
        Nothing is said where it is not known.

    Returns
    -------
    dict of str to StrokesSay
        By effect.
    """
    return {
        e.name: StrokesSay(
            effect=e, alone=wander.of_drift, beside_cutting=wander.of_drift, size=0.0, size_std=math.inf
        )
        for e in effects if wander is not None and isinstance(e.strokes, ZeroTrend)
    }  # fmt: skip


def with_mean_strokes(
    not_the_woods: Mapping[str, float], said: Mapping[str, StrokesSay], strokes: Sequence[StrokeSeries],
    of_means: Mapping[str, float],
) -> dict[str, float]:  # fmt: skip
    """Add to a wave in time what mean strokes say of one in the wood, where all trials have one feed.

    There the two are the same wave: what mean strokes add to one and not to the other would tell them apart by chance.

    Parameters
    ----------
    not_the_woods, said : mapping
        Of `strokes_say`.
    strokes : sequence of StrokeSeries
    of_means : mapping of str to float
        Log evidence of every single effect by mean strokes.
    """
    found = dict(not_the_woods)
    waves = [
        name for name, one in said.items()
        if isinstance(one.effect.strokes, StrokeWave) and one.alone > 0.0 and name in of_means
    ]  # fmt: skip
    if waves and WAVE_IN_TIME in found and len({one.feed_m_s for one in strokes}) == 1:
        found[WAVE_IN_TIME] += max(of_means[name] for name in waves)
    return found


def _wave_in_time(spectra: StrokeSpectra, known: Sequence[KnownEffect]) -> float:
    """Log evidence of a wave at one frequency in Hz, beyond that of a wave along the feed that the model holds."""
    held = [one.effect.strokes for one in known if isinstance(one.effect.strokes, StrokeWave)]
    along_feed = max((spectra.wave(wave).log_evidence for wave in held), default=0.0)
    return max(spectra.wave_in_time() - max(along_feed, 0.0), 0.0)


def with_strokes(
    hypotheses: Sequence[Hypothesis], said: StrokesSay, known: Mapping[str, Effect], settings: Settings
) -> list[Hypothesis]:
    """Add what single strokes say of one effect to all hypotheses that hold it, and hold it beside the best others.

    Parameters
    ----------
    hypotheses : sequence of Hypothesis
    said : StrokesSay
    known : mapping of str to Effect
        All effects of the machine.
    settings : Settings

    Returns
    -------
    list of Hypothesis
        With the part of their log evidence that single strokes give.
    """
    effect = said.effect.name
    evidence = {h.effects: h.log_evidence for h in hypotheses}
    if (effect,) not in evidence:
        return list(hypotheses)
    joined: dict[tuple[str, ...], Hypothesis] = {h.effects or (h.name,): h for h in hypotheses}
    for h in hypotheses:
        if effect not in h.effects:
            continue
        rest = h.without(effect)
        nats = said.beside([known[name] for name in rest])
        value = said.joined(h, evidence.get(rest, 0.0) if rest else 0.0, nats, settings.strokes)
        joined[h.effects] = replace(h, log_evidence=value, of_strokes=h.of_strokes + nats)
    singles = sorted((h for h in hypotheses if len(h.effects) == 1), key=lambda h: -h.log_evidence)
    alone = next(h for h in singles if h.effects == (effect,))
    for h in [h for h in singles if h is not alone][: settings.forms.n_first]:
        nats = said.beside([known[name] for name in h.effects])
        if said.is_trend and nats <= 0.0:
            continue
        both = sorted((alone, h), key=lambda one: one.effects)
        fresh = Hypothesis(
            effects=tuple(name for one in both for name in one.effects),
            members=tuple(member for one in both for member in one.members),
            log_evidence=h.log_evidence + nats, of_strokes=h.of_strokes + nats,
        )  # fmt: skip
        before = joined.get(fresh.effects, fresh)
        more = max(before, fresh, key=lambda one: one.log_evidence)
        joined[fresh.effects] = replace(before, log_evidence=more.log_evidence, of_strokes=more.of_strokes)
    return list(joined.values())


def sized_by_strokes(explanation: Explanation, said: Mapping[str, StrokesSay]) -> Explanation:
    """Magnitude of an effect from the single strokes, where they carry it and know it better than mean strokes do.

    Parameters
    ----------
    explanation : Explanation
    said : mapping of str to StrokesSay

    Returns
    -------
    Explanation
        With the depth of a wave or the size of a trend; others as they were.
    """
    found = said.get(explanation.effect.name)
    if found is None or found.beside_cutting <= 0.0 or not math.isfinite(found.size_std):
        return explanation
    if found.is_trend and found.size_std * abs(explanation.strength) > explanation.strength_std * abs(found.size):
        return explanation
    typical = explanation.effect.strength.typical
    # A trend is the hardness of the same law: its forms differ by what they differ by in mean strokes.
    form_share = explanation.shape_spread if found.is_trend else 0.0
    return replace(explanation, mixture=(found.size / typical, found.size_std / typical), form_share=form_share)
