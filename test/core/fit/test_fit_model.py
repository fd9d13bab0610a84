# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
import pytest
from allan_ros.core.fit.gls import _options_of

from allan_ros.core.fit.model import AxisFit, Coefficient, GaussMarkov, Processes, Sinusoid
from allan_ros.core.noise import NoiseTerms

DRIFT = GaussMarkov(2e-4, (1e-4, 3e-4), 300.0, (200.0, 400.0))
FAST = GaussMarkov(1e-4, (1e-4, 2e-4), 3.0, (2.0, 4.0))
LINE = Sinusoid(1e-3, (9e-4, 1.1e-3), 20.0, (19.9, 20.1))


def test_the_selected_model_has_resolved_terms_with_sign_and_all_processes():
    fit = AxisFit(
        {
            'Q': Coefficient(None, status='not_observable'),
            'N': Coefficient(1e-3, (0.9e-3, 1.1e-3)),
            'B': Coefficient(1e-4, (0.5e-4, 2e-4)),
            'K': Coefficient(1e-5, upper95=2e-5, status='not_observable'),
            'R': Coefficient(1e-8, (0.5e-8, 2e-8), sign=-1),
        },
        processes=Processes((FAST, DRIFT), (LINE,)),
    )
    assert fit.model.terms == NoiseTerms(N=1e-3, B=1e-4, R=-1e-8)
    assert fit.model.gauss_markov == ((1e-4, 3.0), (2e-4, 300.0))
    assert fit.model.sinusoids == ((1e-3, 20.0),)
    assert (fit.gauss_markov, fit.sinusoid) == (DRIFT, LINE)


def test_without_processes_the_selected_model_is_the_five_terms():
    fit = AxisFit({t: Coefficient(1e-3, (0.5e-3, 2e-3)) for t in 'QNBKR'})
    assert fit.model.terms == NoiseTerms(1e-3, 1e-3, 1e-3, 1e-3, 1e-3)
    assert fit.gauss_markov is None and fit.sinusoid is None


def test_the_selected_model_has_no_unresolved_term_beyond_its_own_limit():
    def with_bias(value: float) -> NoiseTerms:
        bias = Coefficient(value, upper95=3e-4, status='not_observable')
        return AxisFit({'N': Coefficient(1e-3, (0.9e-3, 1.1e-3)), 'B': bias}).selected.terms

    assert with_bias(2.5e-4) == NoiseTerms(N=1e-3, B=2.5e-4)
    assert with_bias(4e-4) == NoiseTerms(N=1e-3)


@pytest.mark.parametrize('signed', [False, True])
def test_a_missing_q_does_not_imply_a_filter(signed):
    """A model error can leave Q without a limit, as a low-pass filter does."""
    nothing = Coefficient(None, status='not_observable')
    fit = AxisFit({**dict.fromkeys('QBKR', nothing), 'N': Coefficient(1e-3)}, 0.3, signed=signed)
    assert _options_of(fit, 0.01).signed is signed
