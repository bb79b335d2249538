import numpy as np
import pytest
from scipy.stats import matrix_normal, multivariate_normal
from sklearn.base import clone
from sklearn.linear_model import LinearRegression
from sklearn.preprocessing import PolynomialFeatures

from legtool.models.motion import (
    FORMULATIONS,
    Z90,
    BayesianLinear,
    LeastSquares,
    _evidence_precision,
    build,
    predict_frozen,
)
from legtool_runtime.motion.features import FEATURES, FEET

OFFSET = np.concatenate([np.zeros(12), np.tile([0.24, 0.13, -0.35], 4)])
SCALE = np.concatenate([np.full(12, 0.4), np.full(12, 0.02)])
NOISE = np.array([[0.010, 0.0, 0.0], [0.006, 0.008, 0.0], [0.0, 0.001, 0.003]])


def steps(n=400, seed=0, *, curve=0.0, constant=()):
    rng = np.random.default_rng(seed)
    x = OFFSET + SCALE * rng.standard_normal((n, 24))
    x[:, list(constant)] = 0.0
    weights = np.random.default_rng(99).standard_normal((24, 3)) / SCALE[:, None] * 0.02
    y = (x - OFFSET) @ weights + curve * (x[:, :1] * x[:, 6:7]) + rng.standard_normal((n, 3)) @ NOISE.T
    return x, y


@pytest.mark.parametrize("formulation", FORMULATIONS)
@pytest.mark.parametrize("estimator", ["ols", "bayesian"])
def test_frozen_numbers_predict_as_the_estimator_does(estimator, formulation):
    x, y = steps(constant=(7, 8))  # a log of forward commands alone
    model = build(estimator, formulation).fit(x, y)
    frozen = model.frozen()
    elsewhere, _ = steps(200, seed=1)
    mean, std = model.predict(elsewhere, return_std=True)
    frozen_mean, frozen_std = predict_frozen(frozen, elsewhere)
    np.testing.assert_allclose(frozen_mean, mean, rtol=0, atol=1e-9)
    np.testing.assert_allclose(frozen_std, std, rtol=1e-6, atol=1e-9)
    d = 324 if formulation == "poly2" else 24
    assert frozen["coefficients"].shape == (3, d) and frozen["weights_covariance"].shape == (d + 1, d + 1)
    unseen = np.setdiff1d(np.arange(24), FORMULATIONS[formulation])
    assert not frozen["coefficients"][:, unseen].any() and not frozen["weights_covariance"][1 + unseen].any()


def test_least_squares_is_scikit_learns():
    x, y = steps()
    expected = LinearRegression().fit(x, y).predict(x)
    np.testing.assert_allclose(LeastSquares().fit(x, y).predict(x), expected, atol=1e-12)
    products = PolynomialFeatures(2, include_bias=False).fit_transform((x - OFFSET) / SCALE)
    expected = LinearRegression().fit(products, y).predict(products)
    np.testing.assert_allclose(LeastSquares("poly2").fit(x, y).predict(x), expected, atol=1e-9)


def test_the_chosen_precision_maximises_the_matrix_normal_evidence():
    x, y = steps(60)
    design = (x - x.mean(axis=0)) / x.std(axis=0)
    centred = y - y.mean(axis=0)

    def evidence(precision):
        rows = np.eye(len(x)) + design @ design.T / precision
        noise = centred.T @ np.linalg.solve(rows, centred) / len(x)
        return matrix_normal.logpdf(centred, rowcov=rows, colcov=noise)

    best = _evidence_precision(design, y)
    assert evidence(best) >= max(evidence(best * factor) for factor in (0.3, 0.8, 1.25, 3.0))


def test_the_predictive_covariance_is_the_conjugate_posteriors():
    # against brute force: weights vec(W) ~ N(0, Σ ⊗ λ⁻¹I) conditioned on the data, intercept flat
    x, y = steps(80)
    model = BayesianLinear(folds=0).fit(x, y)
    design = np.column_stack([np.ones(len(x)), (x - x.mean(axis=0)) / x.std(axis=0)])
    prior = np.diag([1e-12, *np.full(24, model.precision_)])
    posterior = np.linalg.inv(design.T @ design + prior)
    mean, covariance = model.predict(x[:3], return_cov=True)
    np.testing.assert_allclose(mean, design[:3] @ (posterior @ design.T @ y), atol=1e-9)
    factor = 1 + np.einsum("ni,ij,nj->n", design[:3], posterior, design[:3])
    np.testing.assert_allclose(covariance, factor[:, None, None] * model.noise_covariance_, rtol=1e-6)
    centred = y - y.mean(axis=0)
    rows = np.eye(len(x)) + design[:, 1:] @ design[:, 1:].T / model.precision_
    np.testing.assert_allclose(model.noise_covariance_, centred.T @ np.linalg.solve(rows, centred) / len(x), rtol=1e-6)


@pytest.mark.parametrize("formulation", ["full", "no_feet", "poly2"])
def test_ninety_percent_intervals_hold_about_ninety_percent_of_steps_not_seen(formulation):
    x, y = steps(3000, curve=0.05)
    mean, std = BayesianLinear(formulation).fit(x[:1000], y[:1000]).predict(x[1000:], return_std=True)
    inside = (np.abs(mean - y[1000:]) <= Z90 * std).mean(axis=0)
    assert (inside > 0.87).all() and (inside < 0.93).all()


def test_correlated_outputs_are_predicted_with_their_correlation():
    x, y = steps(2000)
    mean, covariance = BayesianLinear().fit(x, y).predict(x, return_cov=True)
    jointly = multivariate_normal(cov=covariance[0]).logpdf(y - mean).sum()
    apart = multivariate_normal(cov=np.diag(np.diagonal(covariance[0]))).logpdf(y - mean).sum()
    assert jointly > apart + 100


def test_intervals_widen_away_from_what_was_seen():
    x, y = steps(constant=(7, 8))
    model = BayesianLinear().fit(x, y)
    sideways = x[:1].copy()
    sideways[0, 7] = 0.5  # no sideways command was ever seen
    assert (model.predict(sideways, return_std=True)[1] > 2 * model.predict(x[:1], return_std=True)[1]).all()


def test_shrinkage_saves_the_second_order_from_overfitting():
    x, y = steps(380)  # hardly more than the 325 numbers to be found
    unseen, truth = steps(300, seed=5)
    least_squares = LeastSquares("poly2").fit(x, y).predict(unseen) - truth
    bayesian = BayesianLinear("poly2").fit(x, y).predict(unseen) - truth
    assert np.sqrt((bayesian**2).mean()) < 0.9 * np.sqrt((least_squares**2).mean())


def test_an_output_that_never_changes_does_no_harm():
    x, y = steps(100)
    y[:, 1] = 0.0
    mean, std = BayesianLinear().fit(x, y).predict(x, return_std=True)
    assert np.isfinite(mean).all() and np.isfinite(std).all()
    assert not mean[:, 1].any() and not std[:, 1].any()


def test_estimators_are_scikit_learns_to_clone_and_to_configure():
    model = clone(BayesianLinear("no_feet", folds=5))
    assert model.get_params() == {"formulation": "no_feet", "folds": 5}
    x, y = steps(100)
    assert model.fit(x, y[:, 0]).predict(x).shape == (100,)
    assert model.score(x, y[:, 0]) < LeastSquares().fit(x, y[:, 0]).score(x, y[:, 0])
    assert FEET.start == 12 and len(FEATURES) == 24


def test_wrong_shapes_and_values_that_are_not_finite_are_refused():
    x, y = steps(100)
    with pytest.raises(ValueError, match="24"):
        LeastSquares().fit(x[:, :20], y)
    x[3, 4] = np.nan
    with pytest.raises(ValueError, match="NaN"):
        BayesianLinear().fit(x, y)


def test_a_difference_smaller_than_inputs_are_known_to_is_not_built_upon():
    # A planner feeds a model its own predictions: what tells a millimetre between two feet apart is amplified with
    # every step ahead.
    x, y = steps(2000)
    rng = np.random.default_rng(1)
    x[:, 13] = x[:, 12] + 0.0002 * rng.standard_normal(len(x))
    y += 20.0 * (x[:, 13] - x[:, 12])[:, None]
    steep = np.abs(LeastSquares().fit(x, y).frozen()["coefficients"][:, 12:14]).max()
    shrunk = np.abs(BayesianLinear().fit(x, y).frozen()["coefficients"][:, 12:14]).max()
    assert shrunk < 3.0 < 10.0 < steep
