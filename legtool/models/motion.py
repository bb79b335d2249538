"""Estimators of the motion models: least squares as in the paper, and a Bayesian linear one (its future work, [27]).

Both predict with a covariance of one form, ``noise_covariance · (1 + [1, φ]ᵀ weights_covariance [1, φ])``, where φ is
x_FDM (equation 2) or its second-order polynomial. Fitting works on standardised inputs; :meth:`MotionEstimator.frozen`
folds the scaling into the weights, so that the robot can use raw inputs.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar
from scipy.stats import norm
from sklearn.base import BaseEstimator, RegressorMixin
from sklearn.linear_model import LinearRegression, Ridge
from sklearn.preprocessing import PolynomialFeatures, StandardScaler
from sklearn.utils.validation import check_is_fitted, validate_data

from legtool_runtime.motion.features import FEATURES, FEET, PREVIOUS_REFERENCE, PREVIOUS_VELOCITY

Array = NDArray[np.float64]

_ALL = np.arange(len(FEATURES))
#: Table I: the inputs of each formulation; poly2 also uses their squares and products.
FORMULATIONS: dict[str, NDArray[np.intp]] = {
    "full": _ALL,
    "no_history": np.delete(_ALL, np.r_[PREVIOUS_VELOCITY, PREVIOUS_REFERENCE]),
    "no_feet": np.delete(_ALL, FEET),
    "poly2": _ALL,
}
#: Share of the variance of an output below which residuals count as zero.
_LEAST_NOISE = 1e-9
#: Error of a planner's inputs as a share of their spread: beyond the first step they are the models' own predictions.
#: With the evidence alone, a fit relies on a millimetre between two feet, and was off by metres seven steps ahead.
_INPUT_NOISE = 0.05
#: Half width of a 90 % interval in standard deviations.
Z90 = float(norm.ppf(0.95))


class MotionEstimator(RegressorMixin, BaseEstimator, ABC):
    """Common part of both estimators: inputs, predictive covariance, freezing.

    Args:
        formulation: a key of FORMULATIONS.
    """

    def __init__(self, formulation: str = "full") -> None:
        self.formulation = formulation

    def fit(self, X: Array, y: Array) -> Self:
        """Fit to canonical features (n, 24) in the order of FEATURES and targets (n, k), with rows in time order."""
        X, y = validate_data(self, X, y, multi_output=True, y_numeric=True, dtype=np.float64)
        if X.shape[1] != len(FEATURES):
            raise ValueError(f"{X.shape[1]} features, expected the {len(FEATURES)} of x_FDM")
        self._one_output = y.ndim == 1
        y = y.reshape(len(y), -1)
        inputs = X[:, FORMULATIONS[self.formulation]]
        self.scaler_ = StandardScaler().fit(inputs)
        self.polynomial_ = PolynomialFeatures(2, include_bias=False) if self.degree == 2 else None
        if self.polynomial_ is not None:
            products = self.polynomial_.fit_transform(self.scaler_.transform(inputs))
            self.product_scaler_ = StandardScaler().fit(products)
        self._fit_design(self._design(X), y)
        return self

    @property
    def degree(self) -> int:
        """Degree of the polynomial."""
        return 2 if self.formulation == "poly2" else 1

    def predict(self, X: Array, return_std: bool = False, return_cov: bool = False) -> Any:
        """Return the mean (n, k) and, if requested, standard deviations (n, k) or covariances (n, k, k)."""
        check_is_fitted(self)
        X = validate_data(self, X, reset=False, dtype=np.float64)
        design = self._design(X)
        mean = self.linear_.predict(design).reshape(len(X), -1)
        if self._one_output:
            mean = mean[:, 0]
        if not (return_std or return_cov):
            return mean
        factor = _covariance_factor(design, self.weights_covariance_)
        if return_cov:
            return mean, factor[:, None, None] * self.noise_covariance_
        std = np.sqrt(factor[:, None] * np.diagonal(self.noise_covariance_))
        return mean, std[:, 0] if self._one_output else std

    def frozen(self) -> dict[str, Array]:
        """Return the fitted model in raw units.

        Returns:
            ``coefficients`` (k, d), ``intercept`` (k,), ``noise_covariance`` (k, k), ``weights_covariance``
            (d+1, d+1) over [1, φ], ``degree`` (); φ is the 24 features, for degree 2 followed by x_i·x_j for i ≤ j in
            row-major order. Inputs that the formulation does not use have zero weights.
        """
        check_is_fitted(self)
        scaling = self._raw_scaling()
        coefficients = np.atleast_2d(self.linear_.coef_)
        weights = coefficients @ scaling[:, 1:].T
        weights[:, 0] += np.atleast_1d(self.linear_.intercept_)
        covariance = scaling @ self.weights_covariance_ @ scaling.T
        return {
            "coefficients": np.ascontiguousarray(weights[:, 1:]),
            "intercept": np.ascontiguousarray(weights[:, 0]),
            "noise_covariance": self.noise_covariance_.copy(),
            "weights_covariance": 0.5 * (covariance + covariance.T),
            "degree": np.array(self.degree),
        }

    @abstractmethod
    def _fit_design(self, design: Array, y: Array) -> None: ...

    def _design(self, X: Array) -> Array:
        """Standardised inputs of the regression, without the intercept: (n, d)."""
        scaled = self.scaler_.transform(X[:, FORMULATIONS[self.formulation]])
        if self.polynomial_ is None:
            return scaled
        return self.product_scaler_.transform(self.polynomial_.transform(scaled))

    def _raw_scaling(self) -> Array:
        """The matrix T with [1, design] = [1, φ] · T: (1 + d_raw, 1 + d)."""
        columns = FORMULATIONS[self.formulation]
        mean, scale = self.scaler_.mean_, self.scaler_.scale_
        if self.degree == 1:
            scaling = np.zeros((1 + len(FEATURES), 1 + len(columns)))
            scaling[0, 0] = 1.0
            scaling[0, 1:] = -mean / scale
            scaling[1 + columns, 1 + np.arange(len(columns))] = 1 / scale
            return scaling
        size = len(FEATURES)
        first, second = np.triu_indices(size)
        products = 1 + size + np.arange(len(first))
        scaling = np.zeros((1 + size + len(first), 1 + size + len(first)))
        scaling[0, 0] = 1.0
        scaling[0, 1 : 1 + size] = -mean / scale
        scaling[1 + _ALL, 1 + _ALL] = 1 / scale
        # z_i z_j = (x_i x_j - μ_j x_i - μ_i x_j + μ_i μ_j) / (s_i s_j)
        both = scale[first] * scale[second]
        scaling[products, products] = 1 / both
        np.add.at(scaling, (1 + first, products), -mean[second] / both)
        np.add.at(scaling, (1 + second, products), -mean[first] / both)
        scaling[0, products] = mean[first] * mean[second] / both
        outer = self.product_scaler_
        scaling[:, 1:] /= outer.scale_
        scaling[0, 1:] -= outer.mean_ / outer.scale_
        return scaling


class LeastSquares(MotionEstimator):
    """Multivariate linear regression by ordinary least squares (motion paper, III-A, [23])."""

    def _fit_design(self, design: Array, y: Array) -> None:
        self.linear_ = LinearRegression().fit(design, y)
        with_intercept = _with_intercept(design)
        gram = with_intercept.T @ with_intercept
        # constant inputs (a log of forward commands alone) leave the Gram matrix singular
        self.weights_covariance_ = np.linalg.pinv(gram, rcond=1e-10, hermitian=True)
        residual = y - self.linear_.predict(design)
        freedom = max(len(y) - int(np.linalg.matrix_rank(gram, tol=1e-10 * gram.max(), hermitian=True)), 1)
        self.noise_covariance_ = residual.T @ residual / freedom


class BayesianLinear(MotionEstimator):
    """Bayesian linear regression with the conjugate matrix-normal prior W ~ MN(0, λ⁻¹I, Σ) on standardised inputs.

    λ maximises the evidence, with a lower bound that corresponds to noisy inputs, so that a model applied to its own
    predictions step after step stays stable; Σ has its maximum-likelihood value. The standard deviation of each output
    is then scaled so that 90 % intervals contain 90 % of the residuals of contiguous blocks that were left out.

    Args:
        formulation: a key of FORMULATIONS.
        folds: number of contiguous blocks for the calibration; 0 leaves the covariance of the model unchanged.
    """

    def __init__(self, formulation: str = "full", folds: int = 10) -> None:
        super().__init__(formulation)
        self.folds = folds

    def _fit_design(self, design: Array, y: Array) -> None:
        evidence = _evidence_precision(design, y)
        # Least squares on inputs with added noise is least squares with a prior (Bishop, 1995).
        self.precision_ = max(evidence, _INPUT_NOISE**2 * len(design))  # λ
        self.linear_ = Ridge(alpha=self.precision_, solver="cholesky").fit(design, y)
        with_intercept = _with_intercept(design)
        prior = np.full(with_intercept.shape[1], self.precision_)
        prior[0] = 0.0  # the intercept has a flat prior
        prior[1:][~design.any(axis=0)] = evidence  # an input without spread has no noise, and all is possible
        gram = with_intercept.T @ with_intercept
        self.weights_covariance_ = np.linalg.inv(gram + np.diag(prior))
        centred = y - y.mean(axis=0)
        moment = design.T @ centred
        # Yᵀ(I + λ⁻¹XXᵀ)⁻¹Y = YᵀY − YᵀX W, with W the posterior mean
        noise = centred.T @ centred - moment.T @ np.atleast_2d(self.linear_.coef_).T
        self.noise_covariance_ = 0.5 * (noise + noise.T) / len(y)
        if self.folds:
            ratio = _held_out_ratios(with_intercept, y, gram=gram, prior=prior, folds=self.folds)
            std = np.sqrt(np.maximum(np.diagonal(self.noise_covariance_), np.finfo(float).tiny))
            self.calibration_ = np.quantile(np.abs(ratio / std), 0.9, axis=0) / Z90
            self.noise_covariance_ *= np.outer(self.calibration_, self.calibration_)


ESTIMATORS = ("ols", "bayesian")


def build(estimator: str, formulation: str, *, folds: int = 10) -> MotionEstimator:
    """Return an unfitted estimator by name; ``folds`` is for the calibration of the Bayesian one."""
    if estimator == "ols":
        return LeastSquares(formulation)
    return BayesianLinear(formulation, folds)


def predict_frozen(frozen: Mapping[str, Array], features: Array) -> tuple[Array, Array]:
    """Return mean (n, k) and standard deviation (n, k) of a frozen model for canonical features (n, 24)."""
    inputs = features
    if int(frozen["degree"]) == 2:
        first, second = np.triu_indices(features.shape[1])
        inputs = np.concatenate([features, features[:, first] * features[:, second]], axis=1)
    mean = inputs @ frozen["coefficients"].T + frozen["intercept"]
    factor = _covariance_factor(inputs, frozen["weights_covariance"])
    return mean, np.sqrt(factor[:, None] * np.diagonal(frozen["noise_covariance"]))


def conformal_factors(frozen: Mapping[str, Array], features: Array, target: Array) -> Array:
    """(k,) by what the standard deviations of a frozen model are to be multiplied, so that 90 % intervals hold at least
    90 % of further steps like these: split conformal prediction with scores |y - mean| / std (Lei et al., 2018).

    Args:
        frozen: model that was not fitted to these steps.
        features: (n, 24) canonical features, n at least 9.
        target: (n, k) what came of them.
    """
    mean, std = predict_frozen(frozen, features)
    scores = np.sort(np.abs(target - mean) / np.maximum(std, np.finfo(float).tiny), axis=0)
    rank = int(np.ceil(0.9 * (len(scores) + 1)))
    return np.asarray(scores[rank - 1] / Z90)


def rescaled(frozen: Mapping[str, Array], factors: Array) -> dict[str, Array]:
    """A frozen model whose standard deviations are multiplied by ``factors`` (k,)."""
    return {**frozen, "noise_covariance": frozen["noise_covariance"] * np.outer(factors, factors)}


def _with_intercept(design: Array) -> Array:
    return np.concatenate([np.ones((len(design), 1)), design], axis=1)


def _covariance_factor(inputs: Array, weights_covariance: Array) -> Array:
    extended = _with_intercept(inputs)
    return 1.0 + np.maximum(((extended @ weights_covariance) * extended).sum(axis=1), 0.0)


def _evidence_precision(design: Array, y: Array) -> float:
    """λ that maximises the evidence of Y ~ MN(0, I + λ⁻¹XXᵀ, Σ) with Σ at its maximum."""
    n, k = y.shape
    centred = y - y.mean(axis=0)
    eigenvalues, vectors = np.linalg.eigh(design.T @ design)
    eigenvalues = np.maximum(eigenvalues, 0.0)
    moment = vectors.T @ (design.T @ centred)
    total = centred.T @ centred
    # an output that is constant, or met exactly, must not make the determinant vanish
    spread = np.sqrt(np.diagonal(total))
    spread[spread == 0] = 1.0

    def negative_log_evidence(log_precision: float) -> float:
        precision = 10.0**log_precision
        noise = total - (moment / (eigenvalues + precision)[:, None]).T @ moment
        _, log_determinant = np.linalg.slogdet(noise / np.outer(spread, spread) + _LEAST_NOISE * np.eye(k))
        return k * np.log1p(eigenvalues / precision).sum() + n * log_determinant

    # with fewer rows than inputs there can be several maxima: the best of a grid, then its neighbourhood
    grid = np.linspace(-6.0, 6.0, 25)
    best = grid[int(np.argmin([negative_log_evidence(point) for point in grid]))]
    return 10.0 ** float(minimize_scalar(negative_log_evidence, bounds=(best - 0.5, best + 0.5), method="bounded").x)


def _held_out_ratios(with_intercept: Array, y: Array, *, gram: Array, prior: Array, folds: int) -> Array:
    """Residuals of contiguous left-out blocks over the root of the covariance's factor there: (n, k)."""
    moment = with_intercept.T @ y
    ratios = np.empty_like(y)
    for block in np.array_split(np.arange(len(y)), min(folds, len(y))):
        rows = with_intercept[block]
        inverse = np.linalg.inv(gram - rows.T @ rows + np.diag(prior))
        residual = y[block] - rows @ (inverse @ (moment - rows.T @ y[block]))
        ratios[block] = residual / np.sqrt(1.0 + ((rows @ inverse) * rows).sum(axis=1))[:, None]
    return ratios
