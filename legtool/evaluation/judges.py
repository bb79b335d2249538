"""Verdicts on models, perception and planners: the criteria of each, by the metrics of its evaluation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from legtool.evaluation.report.results import Metric, metric
from legtool.verdict import Finding, Level, Verdict, graded

#: By names of criteria: from where on a figure is green, and from where on amber.
_SAFE, _REGRET, _MEDIAN_ERROR = (0.98, 0.937), (0.02, 0.05), (0.04, 0.10)
_MIOU, _TRAP, _ACCURATE = (0.85, 0.70), (0.01, 0.03), (0.25, 0.60)
_PURITY, _OVERHANG, _COVERAGE = (0.95, 0.90), (0.002, 0.01), (0.60, 0.40)
_HITS, _BARE = (0.01, 0.05), (0.0, 0.05)
_REACHED, _LATE = (0.95, 0.80), (0.01, 0.05)
#: With fewer of them a figure says little, which is amber whatever it is.
_SCENES, _WALKS, _TRIALS = 30, 20, 20

#: Coverage of 90 % intervals that is green, and that is not yet red; the least and the largest share.
_HOLDS, _HOLDS_ROUGHLY = (0.85, 0.95), (0.75, 0.99)
#: RMSE on x as a share of that of the mean of all steps: below the first green, below the second amber.
_BETTER, _NO_BETTER = 0.5, 0.9
#: Steps for each of 25 parameters: ten are green, three amber.
_ENOUGH, _TOO_FEW = 250, 75


def judge_motion(metrics: Mapping[str, Metric], steps: int, constant: Sequence[str] = ()) -> Verdict:
    """Judge motion models by their held-out errors.

    Criteria: 90 % intervals hold 85 to 95 % of the steps on every axis (amber: 75 to 99 %); the error on x of FDM, CDM
    and CVM is below half that of the mean of all steps (amber: 0.9 of it); at least 250 steps (amber: 75); every
    command varies in the data (amber otherwise).

    Args:
        metrics: of ``evaluate_motion``.
        steps: that were measured on.
        constant: lines of ``constant_commands``.
    """
    count = graded(
        steps >= _ENOUGH, steps >= _TOO_FEW, f"{steps} steps, expected at least {_ENOUGH}", "collect more steps"
    )
    findings = [_intervals(metrics), *(_error(metrics, model) for model in ("fdm", "cdm", "cvm")), count]
    findings += [Finding("amber", *line.split("; ", 1)) for line in constant]
    return Verdict(tuple(findings))


def _intervals(metrics: Mapping[str, Metric]) -> Finding:
    shares = [entry["value"] for name, entry in metrics.items() if name.endswith(".coverage90")]
    low, high = min(shares), max(shares)
    text = f"90 % intervals hold {100 * low:.1f} to {100 * high:.1f} % of the steps, expected 85 to 95 % on every axis"
    level = _between(low, high, _HOLDS, _HOLDS_ROUGHLY)
    few = low < _HOLDS[0]
    advice = (
        "the intervals are too narrow: these steps differ from those of the fit; train on logs like them"
        if few
        else "the intervals are too wide: the planner will be too careful; train on cleaner or more data"
    )
    return Finding(level, text, "" if level == "green" else advice)


def _between(low: float, high: float, good: tuple[float, float], fair: tuple[float, float]) -> Level:
    if good[0] <= low and high <= good[1]:
        return "green"
    return "amber" if fair[0] <= low and high <= fair[1] else "red"


def _error(metrics: Mapping[str, Metric], model: str) -> Finding:
    error, naive = (metrics[f"{model}.{which}.x.rmse"]["value"] for which in ("bayesian", "naive"))
    share = error / naive if naive > 0 else float("inf")
    text = f"{model.upper()}: RMSE on x is {100 * share:.0f} % of that of the mean of all steps, expected below 50 %"
    advice = "the inputs tell little of the step: check the command's topic, the stamps and the feet, or vary the speed"
    return graded(share < _BETTER, share < _NO_BETTER, text, advice)


def judge_foothold(metrics: Mapping[str, Metric], network: str) -> Verdict:
    """Judge a foothold network on fresh terrain.

    Criteria of VFA: it chooses a safe cell, or rightly none, on 98 % of the maps (amber: 93.7 %, the ViTAL paper's
    figure), and is right on more of them than the check that it starts from. Of VPA: a regret of at most 2 % (amber:
    5 %), a median error of at most 4 % (amber: 10 %), less than that of the check that it starts from. Of both: enough
    terrains for 95 % intervals.

    Args:
        metrics: of ``eval_foothold``.
        network: that was measured, as it stands in the names of the metrics.
    """
    findings = []
    if safe := metrics.get(f"vfa.{network}.safe"):
        perfect, guess = metrics[f"vfa.{network}.perfect"], metrics["vfa.guess.perfect"]
        findings += [
            _at_least(safe, _SAFE, "safe footholds", "choose footholds by the exact criteria, or train on more maps"),
            _above_guess(perfect, guess, "right answers", more=True),
            _interval(safe, "terrains"),
        ]
    if regret := metrics.get(f"vpa.{network}.regret"):
        error, guess = metrics[f"vpa.{network}.median_error"], metrics["vpa.guess.median_error"]
        longer = "train on more maps, or for more epochs"
        findings += [
            _at_most(regret, _REGRET, "regret: safe footholds lost by its hip height", longer),
            _at_most(error, _MEDIAN_ERROR, "median error of its counts", longer),
            _above_guess(error, guess, "median error of the counts", more=False),
            _interval(regret, "terrains"),
        ]
    return Verdict(tuple(findings))


def judge_steppability(metrics: Mapping[str, Metric]) -> Verdict:
    """Judge a segmenter on scenes that it never saw.

    Criteria: a mean IoU of at least 0.85 (amber: 0.70); at most 1 % of what cannot be passed called steppable (amber:
    3 %); its errors at most a quarter of those of the most frequent label everywhere (amber: 60 %); at least 30 scenes
    (amber otherwise).

    Args:
        metrics: of ``eval_steppability``.
    """
    miou, accuracy = (metrics[f"steppability.{name}"] for name in ("miou", "accuracy"))
    classes = [entry for name, entry in metrics.items() if name.startswith("steppability.iou.")]
    naive = 1.0 - max(entry["n"] for entry in classes) / accuracy["n"]
    share = (1.0 - accuracy["value"]) / naive if naive > 0 else float("inf")
    more = "train on more scenes, or for more epochs"
    findings = [
        _at_least(miou, _MIOU, "mean IoU", more, percent=False),
        graded(
            share <= _ACCURATE[0], share <= _ACCURATE[1],
            f"its errors are {100 * share:.0f} % of those of the most frequent label everywhere, expected at most "
            f"{100 * _ACCURATE[0]:.0f} %", more,
        ),
        _count(metrics["steppability.scenes"], _SCENES, "scenes"),
    ]  # fmt: skip
    trap = metrics.get("steppability.confusion.non_passable.steppable")
    if trap is not None and trap["n"]:
        advice = "feet would be set there: raise the weight of that class, or train on scenes with more of it"
        findings.insert(1, _at_most(trap, _TRAP, "pixels that cannot be passed and are called steppable", advice))
    return Verdict(tuple(findings))


def judge_perception(metrics: Mapping[str, Metric]) -> Verdict:
    """Judge planar regions on noisy depth.

    Criteria: at least 95 % of the regions lie wholly on one planar face (amber: 90 %), and not fewer than of planes cut
    out of an elevation map; at most 0.2 % of their area hangs over edges (amber: 1 %); at least 60 % of the steppable
    floor is covered (amber: 40 %); at least 20 walks (amber otherwise).

    Args:
        metrics: of ``eval_perception``.
    """
    found = {name: metrics.get(f"perception.noisy.{name}") for name in ("region_purity", "overhang", "coverage")}
    purity, overhang, coverage = found.values()
    if purity is None or overhang is None or coverage is None:
        said = "no region was found on noisy depth"
        return Verdict((Finding("red", said, "look at the page's drawings: labels, heights, the camera's pose"),))
    mixed = "feet could stand on edges: check the camera's pose and noise, or raise the margin of the planner"
    findings = [
        _at_least(purity, _PURITY, "regions wholly on one planar face", mixed),
        _at_most(overhang, _OVERHANG, "area over edges", mixed),
        _at_least(coverage, _COVERAGE, "steppable floor covered", "planners see few footholds; look at the labels"),
        _count(metrics["perception.walks"], _WALKS, "walks"),
    ]
    if baseline := metrics.get("perception.noisy.baseline.region_purity"):
        ahead = purity["value"] >= baseline["value"]
        text = f"planes cut out of an elevation map: {100 * baseline['value']:.1f} % wholly on one face"
        findings.insert(1, graded(ahead, True, f"{text}, expected no more than of the regions", mixed))
    return Verdict(tuple(findings))


def judge_poses(metrics: Mapping[str, Metric], walks: Sequence[str]) -> Verdict:
    """Judge pose adaptation (VPA) on kinematic walks, beside a pose from the terrain's plane (TBR).

    Criteria over all walks: no leg is ever without a safe foothold (amber: on 5 % of the way); at most 1 % of the steps
    collide, and as many leave the workspace (amber: 5 % each); no fewer safe footholds than by TBR.

    Args:
        metrics: of ``eval_vital``.
        walks: their names.
    """
    bare = max((metrics[f"{walk}.vpa.without_safe"] for walk in walks), key=lambda entry: entry["value"])
    own, plane = (sum(metrics[f"{walk}.{way}.mean_safe"]["value"] for walk in walks) for way in ("vpa", "tbr"))
    advice = "look at the page's filmstrips: the steps may be too long or too high for this robot"
    findings = [_at_most(bare, _BARE, "of the worst walk with a leg that has no safe foothold", advice)]
    for key, what in (("collisions", "steps that collide"), ("workspace_violations", "steps beyond the workspace")):
        shares = [metrics[f"{walk}.vpa.{key}"] for walk in walks]
        n = sum(entry["n"] for entry in shares)
        total = metric(sum(entry["value"] * entry["n"] for entry in shares) / n, None, n, "1")
        findings.append(_at_most(total, _HITS, what, advice))
    own, plane = own / len(walks), plane / len(walks)
    text = f"safe footholds, mean of the walks: {own:.0f}, by TBR {plane:.0f}, expected no fewer"
    findings.append(graded(own >= plane, True, text, "the pose from the terrain's plane is as good here"))
    return Verdict(tuple(findings))


def judge_planner(metrics: Mapping[str, Metric], worlds: Sequence[str], rows: Sequence[str]) -> Verdict:
    """Judge planners in closed loop; the blind one is what they are compared with, and is not judged beside others.

    Criteria for each: it reaches the goal in 95 % of all trials (amber: 80 %); at most 1 % of its plans are late
    (amber: 5 %). Of all: at least 20 trials of each world (amber otherwise).

    Args:
        metrics: of ``eval_planner``.
        worlds: that were walked.
        rows: that walked them.
    """
    judged = [row for row in rows if row != "blind"] or list(rows)
    findings, fewest = [], min(metrics[f"{world}.{row}.success"]["n"] for world in worlds for row in judged)
    for row in judged:
        shares = [metrics[f"{world}.{row}.success"] for world in worlds]
        n = sum(entry["n"] for entry in shares)
        reached = sum(entry["value"] * entry["n"] for entry in shares) / n
        worst = min(zip(shares, worlds, strict=True), key=lambda pair: pair[0]["value"])
        text = f"{row}: {100 * reached:.0f} % of {n} trials reached the goal, expected {100 * _REACHED[0]:.0f} %"
        advice = f"look at the page's walks of {worst[1]}, where {100 * worst[0]['value']:.0f} % did"
        findings.append(graded(reached >= _REACHED[0], reached >= _REACHED[1], text, advice))
        late = [metrics[name] for world in worlds if (name := f"{world}.{row}.planning_late") in metrics]
        if plans := sum(entry["n"] for entry in late):
            share = sum(entry["value"] * entry["n"] for entry in late) / plans
            text = f"{row}: {100 * share:.2g} % of {plans} plans were late, expected at most {100 * _LATE[0]:.0f} %"
            advice = "walk with --workers 1 on an idle machine, or plan fewer steps ahead"
            findings.append(graded(share <= _LATE[0], share <= _LATE[1], text, advice))
    text = f"{fewest} trials of each world and planner, expected at least {_TRIALS}"
    findings.append(graded(fewest >= _TRIALS, True, text, "walk more of them with --trials"))
    return Verdict(tuple(findings))


def _said(value: float, *, percent: bool = True) -> str:
    return f"{100 * value:.3g} %" if percent else f"{value:.3g}"


def _at_least(
    entry: Metric, bounds: tuple[float, float], what: str, advice: str, *, percent: bool = True
) -> Finding:  # fmt: skip
    value, (green, amber) = entry["value"], bounds
    text = f"{what}: {_said(value, percent=percent)}, expected at least {_said(green, percent=percent)}"
    return graded(value >= green, value >= amber, text, advice)


def _at_most(entry: Metric, bounds: tuple[float, float], what: str, advice: str) -> Finding:
    value, (green, amber) = entry["value"], bounds
    return graded(value <= green, value <= amber, f"{what}: {_said(value)}, expected at most {_said(green)}", advice)


def _count(entry: Metric, least: int, what: str) -> Finding:
    n = round(entry["value"])
    return graded(n >= least, True, f"{n} {what}, expected at least {least}", f"measure on more {what}")


def _above_guess(entry: Metric, guess: Metric, what: str, *, more: bool) -> Finding:
    better = entry["value"] > guess["value"] if more else entry["value"] < guess["value"]
    text = (
        f"{what}: {_said(entry['value'])}, of the check that the network starts from {_said(guess['value'])}, expected "
        f"{'more' if more else 'less'}"
    )
    return graded(better, True, text, "the network adds nothing to that check: use the criteria themselves (exact)")


def _interval(entry: Metric, what: str) -> Finding:
    text = f"95 % interval from {entry['n']} samples: {'none' if entry['ci95'] is None else 'taken'}, expected one"
    return graded(entry["ci95"] is not None, True, text, f"measure on more {what}")
