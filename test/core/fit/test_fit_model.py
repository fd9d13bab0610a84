# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
from allan_ros.core.fit.model import AxisFit, Coefficient, model_of_terms
from allan_ros.core.noise import NoiseTerms, ProcessModel


def test_limits_replace_only_terms_that_are_not_resolved():
    noise = {
        'N': Coefficient(1e-3, (0.9e-3, 1.1e-3)),
        'B': Coefficient(1e-4, None, 2e-4, 'likely'),
        'K': Coefficient(None, None, 3e-5, 'not_observable'),
        'R': Coefficient(None, status='not_observable'),
    }
    model = ProcessModel(NoiseTerms(N=1e-3, B=1e-4, R=2e-9), ((2e-4, 300.0),))
    fit = AxisFit(noise, model)
    limits = fit.model_at_limits
    assert limits.terms == NoiseTerms(N=1e-3, B=2e-4, K=3e-5, R=2e-9)
    assert limits.gauss_markov == model.gauss_markov
    assert fit.likely == ('B',)


def test_a_model_of_terms_has_the_sign_of_the_ramp():
    noise = {'N': Coefficient(1e-3), 'B': Coefficient(None), 'R': Coefficient(1e-8, sign=-1)}
    assert model_of_terms(noise).terms == NoiseTerms(N=1e-3, R=-1e-8)
