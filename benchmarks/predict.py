"""Time of one motion prediction: 11 commands with standard deviations for one state, through the runtime's Python API.

    python benchmarks/predict.py [BUNDLE]

Without a bundle, models fitted to random steps are timed: the time depends on the degree alone, not on the figures.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import time
from collections.abc import Callable

import numpy as np

from legtool_runtime import MotionModel, MotionState, load_bundle
from legtool_runtime.motion.features import REFERENCE, TARGET_SIGN, TARGETS, canonical_features
from legtool_runtime.motion.kernels import design
from legtool_runtime.robot import TROT_PAIRS

# The action space of the motion paper, III-B: 0 to 1 m/s in steps of 0.1.
COMMANDS = np.stack([np.linspace(0.0, 1.0, 11), np.zeros(11), np.zeros(11)], axis=1)
TOLERANCE = 1e-9
CALLS = 20_000
FRESH_PROCESSES = 11
SPACED_CALLS = 11
PAUSE_S = 0.03


def fitted(degree: int) -> MotionModel:
    """Least squares on 2000 random steps."""
    rng = np.random.default_rng(degree)
    x = rng.normal(scale=0.3, size=(2000, 24))
    phi = design(x, degree)
    gram = np.linalg.inv(phi.T @ phi + 1e-3 * np.eye(phi.shape[1]))
    parameters = {}
    for name, targets in TARGETS.items():
        k = len(targets)
        y = x @ rng.normal(size=(24, k)) + 0.01 * rng.normal(size=(2000, k))
        weights = gram @ phi.T @ y
        parameters[f"{name}.intercept"] = weights[0]
        parameters[f"{name}.coefficients"] = weights[1:].T
        parameters[f"{name}.noise_covariance"] = np.cov((y - phi @ weights).T)
        parameters[f"{name}.weights_covariance"] = (gram + gram.T) / 2
    return MotionModel(parameters, degree=degree, instant="touchdown")


def random_state(rng: np.random.Generator) -> MotionState:
    return MotionState(*rng.normal(scale=0.3, size=(3, 3)), rng.normal(scale=0.3, size=(4, 3)), int(rng.integers(2)))


def rows(state: MotionState) -> np.ndarray:
    features = np.tile(state.features, (len(COMMANDS), 1))
    features[:, REFERENCE] = COMMANDS
    return canonical_features(features, np.full(len(COMMANDS), state.swing_pair, dtype=np.int8))


def with_numpy(model: MotionModel, state: MotionState) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Mean and standard deviation of each model by its formula, without the runtime's kernels."""
    phi = design(rows(state), model.degree)
    out = {}
    for name in TARGETS:
        sign = TARGET_SIGN[name] if state.swing_pair == 1 else 1.0
        p = model.parameters
        mean = (phi[:, 1:] @ p[f"{name}.coefficients"].T + p[f"{name}.intercept"]) * sign
        spread = 1 + np.einsum("ni,ij,nj->n", phi, p[f"{name}.weights_covariance"], phi)
        out[name] = mean, np.sqrt(spread[:, None] * np.diag(p[f"{name}.noise_covariance"]))
    return out


def sklearn_models(model: MotionModel) -> Callable[[MotionState], list[np.ndarray]] | None:
    """The same means from scikit-learn's own classes, where it is installed."""
    try:
        from sklearn.linear_model import LinearRegression
    except ImportError:
        return None
    estimators = []
    for name in TARGETS:
        estimator = LinearRegression()
        estimator.coef_ = model.parameters[f"{name}.coefficients"]
        estimator.intercept_ = model.parameters[f"{name}.intercept"]
        estimators.append(estimator)

    def predict(state: MotionState) -> list[np.ndarray]:
        phi = design(rows(state), model.degree)[:, 1:]
        signs = TARGET_SIGN.values() if state.swing_pair == 1 else (1.0, 1.0, 1.0)
        return [estimator.predict(phi) * sign for estimator, sign in zip(estimators, signs, strict=True)]

    return predict


def check(model: MotionModel) -> dict[str, float]:
    """Largest difference to each reference over 1000 states; raises where one is above TOLERANCE."""
    rng = np.random.default_rng(0)
    by_sklearn = sklearn_models(model)
    worst: dict[str, float] = {}
    for _ in range(1000):
        state = random_state(rng)
        got = model.predict(state, COMMANDS)
        swing = list(TROT_PAIRS[state.swing_pair])
        mean = [got.foot_displacement[:, swing].reshape(-1, 6), got.com_displacement, got.velocity]
        std = [got.foot_displacement_std[:, swing].reshape(-1, 6), got.com_displacement_std, got.velocity_std]
        for i, value in enumerate(with_numpy(model, state).values()):
            worst["numpy"] = max(
                worst.get("numpy", 0.0), *(np.abs(a - b).max() for a, b in zip((mean[i], std[i]), value, strict=True))
            )
        if by_sklearn is not None:
            difference = max(np.abs(a - b).max() for a, b in zip(mean, by_sklearn(state), strict=True))
            worst["scikit-learn"] = max(worst.get("scikit-learn", 0.0), difference)
    for name, value in worst.items():
        if value > TOLERANCE:
            raise SystemExit(f"error: differs from {name} by {value:.2e}, expected at most {TOLERANCE:.0e}")
    return worst


def timed(call: Callable[[MotionState], object], calls: int) -> np.ndarray:
    """Time of each call [µs], each with a state that it has not seen just before."""
    rng = np.random.default_rng(1)
    states = [random_state(rng) for _ in range(100)]
    times = np.empty(calls)
    for i in range(calls):
        state = states[i % len(states)]
        start = time.perf_counter_ns()
        call(state)
        times[i] = (time.perf_counter_ns() - start) * 1e-3
    return times


def first_call(make: Callable[[], MotionModel]) -> None:
    """Run in a process of its own: print the times of warm_up [ms] and of calls after it [µs].

    The first call follows warm_up at once; the others come apart in time, when the processor has gone idle, as they do
    on a robot.
    """
    state = random_state(np.random.default_rng(2))
    model = make()
    start = time.perf_counter()
    model.warm_up()
    times = [(time.perf_counter() - start) * 1e3]
    for _ in range(1 + SPACED_CALLS):
        begin = time.perf_counter_ns()
        model.predict(state, COMMANDS)
        times.append((time.perf_counter_ns() - begin) * 1e-3)
        time.sleep(PAUSE_S)
    print(*times)


def report(title: str, model: MotionModel, arguments: list[str]) -> None:
    model.warm_up()
    worst = check(model)
    print(f"{title}, 11 commands, one state")
    print("  largest difference: " + ", ".join(f"{value:.1e} to {name}" for name, value in worst.items()))
    times = timed(lambda state: model.predict(state, COMMANDS), CALLS)
    median, p95, p99 = np.percentile(times, [50, 95, 99])
    print(
        f"  legtool_runtime, mean and deviation: median {median:.1f} µs, p95 {p95:.1f}, p99 {p99:.1f} ({CALLS} calls)"
    )
    fresh = np.array(
        [
            subprocess.run([sys.executable, __file__, *arguments, "--first-call"], capture_output=True, check=True)
            .stdout.decode()
            .split()
            for _ in range(FRESH_PROCESSES)
        ],
        dtype=float,
    )
    first = fresh[:, 1]
    print(
        f"  warm-up from the user's cache: {np.median(fresh[:, 0]):.0f} ms (median of {FRESH_PROCESSES} new processes)"
    )
    print(
        f"  first call after it: median {np.median(first):.1f} µs, {np.median(first) / median:.2f} × the median call; "
        f"worst {first.max():.1f} µs"
    )
    print(
        f"  calls {PAUSE_S:g} s apart: first {np.median(fresh[:, 2]):.1f} µs, median {np.median(fresh[:, 3:]):.1f} µs"
    )
    by_sklearn = sklearn_models(model)
    if by_sklearn is not None:
        print(f"  scikit-learn, mean alone: median {np.median(timed(by_sklearn, CALLS // 40)):.0f} µs")
    by_numpy = np.median(timed(lambda state: with_numpy(model, state), CALLS // 40))
    print(f"  plain numpy, mean and deviation: median {by_numpy:.0f} µs")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("bundle", nargs="?")
    parser.add_argument("--degree", type=int, choices=(1, 2))
    parser.add_argument("--first-call", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.first_call:
        first_call(lambda: load_bundle(options.bundle).motion if options.bundle else fitted(options.degree))
    elif options.bundle:
        bundle = load_bundle(options.bundle)
        report(str(bundle), bundle.motion, [options.bundle])
    else:
        for degree in (options.degree,) if options.degree else (1, 2):
            report(f"random models of degree {degree}", fitted(degree), ["--degree", str(degree)])
    if not options.first_call:
        print("the paper gives no time for the models alone; a whole re-planning of 3 steps takes it 230 to 480 µs")


if __name__ == "__main__":
    main()
