"""Models, statistics and gains against numpy, statsmodels and scipy."""

import numpy as np
import pytest

import flyvine


def polynomial(model: dict):
    """x⁺ = c + L w + Σ a_ij w_i w_j, w = (z, u), in numpy, from the bank's file."""
    offset = np.array(model["offset"])
    linear = np.array(model["linear"]).reshape(9, -1)
    p = linear.shape[1]
    quadratic = []
    for terms in model["quadratic"]:
        upper = np.zeros((p, p))
        upper[np.triu_indices(p)] = terms["upper_triangle"]
        quadratic.append((terms["row"], upper))

    def step(state, command):
        w = np.concatenate([state, command])
        fresh = offset + linear @ w
        for row, upper in quadratic:
            fresh[row] += w @ upper @ w
        return np.concatenate([fresh, state[:-9]])

    return step


def test_rollout_is_that_of_numpy(bank, recordings):
    model = bank.at(0.7, 0.0)
    step = polynomial(bank.to_dict()["models"][0]["model"])
    states, commands = recordings[1].states(), recordings[1].commands()
    start = 50
    state = np.concatenate([states[start - lag] for lag in range(model.lags)])
    expected = [state]
    for command in commands[start : start + 200]:
        expected.append(step(expected[-1], command))
    rolled = model.rollout(state, commands[start : start + 200])
    assert rolled.shape == (201, model.state_len)
    np.testing.assert_allclose(rolled, expected, atol=1e-9)
    # It also predicts: 10 s ahead, within 10 cm on average.
    tip = np.linalg.norm(rolled[1:, 6:9] - states[start + 1 : start + 201, 6:9], axis=1)
    assert tip.mean() < 0.1


def test_jacobian_is_that_of_differences(bank):
    model = bank.at(0.7, 0.0)
    state, command = model.rest_state() + 0.05, np.array([0.2, -0.1, 1.6])
    a, b = model.jacobian(state, command)
    h = 1e-6

    def columns(f, n):
        return np.column_stack([(f(h * np.eye(n)[i]) - f(-h * np.eye(n)[i])) / (2 * h) for i in range(n)])

    np.testing.assert_allclose(a, columns(lambda d: model.step(state + d, command), a.shape[1]), atol=1e-7)
    np.testing.assert_allclose(b, columns(lambda d: model.step(state, command + d), 3), atol=1e-7)
    rest, u = model.rest_state(), [0.0, 0.0, 1.5]
    radius = np.abs(np.linalg.eigvals(model.jacobian(rest, u)[0])).max()
    assert model.spectral_radius() == pytest.approx(radius, abs=1e-8)


def test_check_is_the_mean_distance_over_its_windows(bank, recordings):
    """The definition of the rollout error, written again in numpy."""
    flight = recordings[2]
    model = bank.at(0.7, 0.0)
    states, commands = flight.states(), flight.commands()
    lags, steps = model.lags, 50
    errors = []
    for start in range(lags - 1, len(flight) - steps, 10):
        rows = states[start - lags + 1 : start + steps + 1]
        if np.isnan(rows).any():
            continue
        z = np.concatenate([states[start - lag] for lag in range(lags)])
        rolled = model.rollout(z, commands[start : start + steps])[1:, 6:9]
        errors.append(np.linalg.norm(rolled - states[start + 1 : start + steps + 1, 6:9], axis=1).mean())
    reported = next(e for e in bank.check([flight])["flights"][0]["rollout"] if e["horizon_s"] == 2.5)
    assert reported["windows"] == len(errors)
    assert reported["median_m"] == pytest.approx(np.median(errors), rel=1e-9)
    assert reported["p95_m"] == pytest.approx(np.quantile(errors, 0.95), rel=1e-9)


def test_statistics_are_those_of_statsmodels():
    api = pytest.importorskip("statsmodels.api")
    random = np.random.default_rng(3)
    x = np.column_stack([np.ones(200), random.normal(size=(200, 4))])
    x[:, 4] += 2.0 * x[:, 3]
    y = x @ [0.5, -1.0, 2.0, 0.0, 0.3] + random.normal(scale=0.4, size=200)
    ours, theirs = flyvine.regress(x, y, intercept=True), api.OLS(y, x).fit()

    def column(name):
        return [coefficient[name] for coefficient in ours["coefficients"]]

    np.testing.assert_allclose(column("estimate"), theirs.params, rtol=1e-10)
    np.testing.assert_allclose(column("standard_error"), theirs.bse, rtol=1e-10)
    np.testing.assert_allclose(column("t"), theirs.tvalues, rtol=1e-10)
    np.testing.assert_allclose(column("p"), theirs.pvalues, rtol=1e-7, atol=1e-12)
    np.testing.assert_allclose(column("confidence_95"), theirs.conf_int(), rtol=1e-8)
    assert ours["r_squared"] == pytest.approx(theirs.rsquared, rel=1e-12)
    assert ours["adjusted_r_squared"] == pytest.approx(theirs.rsquared_adj, rel=1e-12)
    assert ours["f"] == pytest.approx(theirs.fvalue, rel=1e-9)
    assert ours["rmse"] == pytest.approx(np.sqrt(theirs.mse_resid), rel=1e-12)
    influence = theirs.get_influence()
    np.testing.assert_allclose(ours["leverage"], influence.hat_matrix_diag, rtol=1e-9)
    np.testing.assert_allclose(ours["cooks_distance"], influence.cooks_distance[0], rtol=1e-8, atol=1e-14)
    with pytest.raises(flyvine.ModelError, match="x2 depends on those before it"):
        flyvine.regress(np.column_stack([x[:, 0], x[:, 1], x[:, 1]]), y)


def test_gains_become_those_of_the_algebraic_riccati_equation():
    linalg = pytest.importorskip("scipy.linalg")
    random = np.random.default_rng(5)
    a = random.normal(size=(5, 5))
    a *= 1.05 / np.abs(np.linalg.eigvals(a)).max()  # unstable without feedback
    b = random.normal(size=(5, 2))
    q, r = random.uniform(0.5, 2.0, 5), random.uniform(0.5, 2.0, 2)
    horizon = 400
    gains = flyvine.regulate(np.tile(a, (horizon, 1, 1)), np.tile(b, (horizon, 1, 1)), q, r)
    p = linalg.solve_discrete_are(a, b, np.diag(q), np.diag(r))
    expected = -np.linalg.solve(np.diag(r) + b.T @ p @ b, b.T @ p @ a)
    np.testing.assert_allclose(gains[0], expected, rtol=1e-8, atol=1e-10)
    assert np.abs(np.linalg.eigvals(a + b @ gains[0])).max() < 1.0


def test_a_bank_reads_back_and_refuses_what_it_does_not_cover(bank, tmp_path):
    path = tmp_path / "bank.json"
    bank.write(path)
    assert flyvine.Bank.read(path).to_dict() == bank.to_dict()
    np.testing.assert_array_equal(bank.configurations(), [[0.7, 0.0]])
    with pytest.raises(flyvine.ModelError, match="outside the bank"):
        bank.at(0.9, 0.2)
    with pytest.raises(flyvine.FlyvineError, match="state: found 3 numbers, expected 27"):
        bank.at(0.7, 0.0).step([0.0, 0.0, 0.0], [0.0, 0.0, 1.5])
    with pytest.raises(flyvine.ModelError, match="no flight"):
        flyvine.fit([])
