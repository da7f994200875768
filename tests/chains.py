"""Linkages drawn at random."""

from mech import Chain


def random_chain(rng, n, **more):
    """A chain whose inertias a rigid body can have, in any gravity."""
    fields = {
        "lengths_m": rng.uniform(0.05, 0.3, n),
        "masses_kg": rng.uniform(0.05, 0.5, n),
        "coms_m": rng.uniform(0.0, 0.2, n),
        "inertias_kg_m2": rng.uniform(1e-4, 2e-3, n),
        "rotor_inertia_kg_m2": rng.uniform(1e-7, 4e-6, n),
        "gear": rng.uniform(1.0, 20.0, n),
        "gravity_m_per_s2": rng.uniform(-9.81, 9.81, 2),
    }
    return Chain(**{**fields, **more})
