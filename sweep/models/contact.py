"""Foot contact constants (monograph 1.2.2)."""

from sweep.parameters import parameters, quantity


@parameters
class Contact:
    """Viscoelastic point contact with a Coulomb limit.

    The factor epsilon that the book puts beside d_n is undefined there; it is 1 here.
    """

    stiffness: float = quantity(1e6, "N/m", above=0)  # c_n
    damping: float = quantity(100.0, "N*s/m", at_least=0)  # d_n
    friction: float = quantity(1.0, "-", at_least=0)  # k_f
