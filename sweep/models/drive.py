"""Joint drives (monograph 1.2.1): a PD voltage inside a clamp, back-EMF outside."""

from sweep.parameters import parameters, quantity


@parameters
class Drive:
    """U = clip(stiffness (ref - q) - damping q', +-torque_limit), joint torque M = U - back_emf q'.

    `damping` is -chi2 = 2 sqrt(chi1) + delta - c_e of the book for chi1 = 4.5e4, delta = 100.
    """

    stiffness: float = quantity(4.5e4, "N*m/rad", above=0)  # chi1
    damping: float = quantity(514.26, "N*m*s/rad", at_least=0)  # -chi2
    back_emf: float = quantity(10.0, "N*m*s/rad", at_least=0)  # c_e
    torque_limit: float = quantity(150.0, "N*m", above=0)  # U_max
    armature: float = quantity(0.1, "kg*m^2", at_least=0)  # rotor inertia seen at the joint
