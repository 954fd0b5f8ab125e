"""Parameters of the contact of feet and ground."""

from sweep.core.parameters import parameters, quantity


@parameters
class Contact:
    """Parameters of the viscoelastic point contact with a Coulomb limit.

    The factor epsilon that the book puts beside d_n = 100 N s/m is undefined there; `damping` is their product, chosen
    so that feet hardly rebound (docs/model.md). A step may last no longer than a contact takes to relax, damping over
    stiffness.
    """

    stiffness: float = quantity(1e6, "N/m", above=0)  # c_n, force for each metre that a foot sinks in
    damping: float = quantity(2100.0, "N*s/m", above=0)  # d_n, force against the speed at which a contact moves
    friction: float = quantity(1.0, "-", at_least=0)  # k_f, largest tangential force over the normal force
