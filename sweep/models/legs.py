"""Numbers and names of legs and joints, and their order in arrays."""

LEGS = range(1, 7)  # 1-2 rear, 3-4 middle, 5-6 front, odd on the right
LEG_PAIRS = {"front": (5, 6), "middle": (3, 4), "rear": (1, 2)}
LEG_BY_NAME = {f"{pair}_{side}": (leg,) for pair, legs in LEG_PAIRS.items()
               for leg, side in zip(legs, ("right", "left"), strict=True)}  # fmt: skip
LEG_GROUPS = LEG_PAIRS | LEG_BY_NAME  # that plans name
LEG_NAMES = {leg: name for name, (leg,) in LEG_BY_NAME.items()}  # of single legs
N_LEGS = len(LEGS)
JOINT_KINDS = ("alpha", "beta", "gamma")  # the joints of a leg, from the body outwards
JOINT_NAMES = tuple(f"{kind}{leg}" for leg in LEGS for kind in JOINT_KINDS)
N_JOINTS = len(JOINT_NAMES)
# of MuJoCo's positions and velocities: the base, then the joints, then free bodies
JOINT_Q, JOINT_V = slice(7, 7 + N_JOINTS), slice(6, 6 + N_JOINTS)
