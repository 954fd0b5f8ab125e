"""Solve a step's linear equations: legs are eliminated one by one, then root bodies in blocks of three."""

from functools import reduce
from operator import add
from typing import NamedTuple

from sweep.core.vectors import Matrix, Vector, cross_matrix, diagonal_matrix
from sweep.dynamics.contacts import BodyContactJacobian, ContactSet
from sweep.dynamics.spatial import GeneralizedVector, JointTriple, MassMatrix, SpatialVector


class LegElimination(NamedTuple):
    """Joint rates of the legs, eliminated from the equations: functions of the motion of base and free bodies.

    Columns are the velocities that a leg feels: the base's, its rate of turning, and that of its foot over what it
    stands on by the motion of free bodies (where there are some).
    """

    leg_columns: list[list[Vector]]  # by joint: impulse on the column's partner per rate
    rate_columns: list[list[Vector]]  # by joint: minus its rate per column
    inverse: Matrix
    schur_blocks: list[list[Matrix]]  # what remains between the columns


def newton_direction(
    mass: MassMatrix,
    j_leg: tuple[Vector, Vector, Vector],
    stiff: JointTriple,
    contacts: tuple[ContactSet, ...],
    slopes: list[Matrix],
    rolling: Matrix | None,
    right: GeneralizedVector,
) -> GeneralizedVector:
    """Solve the linear system of a Newton iteration (mass plus stiffness of contacts, drives, rolling) for x.

    `slopes` are -h d force / d velocity of feet and sites, `rolling` is -h d moment / d rate of the sites; `stiff` is
    what drives add to the legs' diagonal.
    """
    feet, *sites = contacts
    base, *others = feet.arms
    legs = _eliminate_legs(mass, j_leg, stiff, base, slopes[0], len(others) > 0)
    blocks = BlockMatrix()
    for i in range(2):
        for j in range(2):
            blocks.add_block(i, j, legs.schur_blocks[i][j].sum_last_axis())
    for arm in others:
        _add_standing_legs(blocks, arm, legs.schur_blocks)
    if sites:
        _add_free_contacts(blocks, sites[0].arms, slopes[1], rolling)
    for k, body in enumerate(mass.root):
        blocks.add_block(2 * k, 2 * k, diagonal_matrix(body.mass, body.mass, body.mass))
        blocks.add_block(2 * k + 1, 2 * k + 1, body.inertia)
        if body.moment is not None:
            cross = cross_matrix(body.moment)
            blocks.add_block(2 * k, 2 * k + 1, cross.negative)
            blocks.add_block(2 * k + 1, 2 * k, cross)
    leg = legs.inverse @ Vector(*right.leg)
    known = [part for body in right.root for part in body]
    for column, rate in zip(legs.leg_columns, leg, strict=True):
        for i in range(2):
            known[i] = known[i] - (rate * column[i]).sum_last_axis()
        for arm in others:
            linear, angular = (2 * arm.body + i for i in range(2))
            own = arm.apply_contact_signs(rate * column[2])
            known[linear] = known[linear] - own.sum_last_axis()
            known[angular] = known[angular] - arm.points.cross(own).sum_last_axis()
    x = blocks.solve(known)
    root = tuple(SpatialVector(x[2 * k], x[2 * k + 1]) for k in range(len(mass.root)))
    felt = [*root[0]]
    if others:
        felt.append(feet._replace(arms=tuple(others)).velocity(root))
    rates = tuple(
        part - reduce(add, (c.dot(v) for c, v in zip(columns, felt, strict=True)))
        for part, columns in zip(leg, legs.rate_columns, strict=True)
    )
    return GeneralizedVector(root, rates)  # pyright: ignore


def _eliminate_legs(
    mass: MassMatrix,
    j_leg: tuple[Vector, Vector, Vector],
    stiff: JointTriple,
    arm: BodyContactJacobian,
    slope: Matrix,
    moving: bool,
) -> LegElimination:
    """Eliminate the legs' joints. `arm` leads from the base to the feet, `moving` to the bodies that they stand on."""
    down = slope.transpose
    pulls = [slope @ j for j in j_leg]  # impulse on a foot per rate of a joint
    pushes = [down @ j for j in j_leg]  # torque of a joint per velocity of the foot

    def columns(forces: list[Vector]) -> list[list[Vector]]:
        parts = [[c.linear + f, c.angular + arm.points.cross(f)] for c, f in zip(mass.cross, forces, strict=True)]
        return [[*own, f] if moving else own for own, f in zip(parts, forces, strict=True)]

    upper, lower = columns(pulls), columns(pushes)
    leg = Matrix(*(Vector(*(j.dot(f) for f in pulls)) for j in j_leg)).plus(mass.leg)
    inverse = leg.plus(diagonal_matrix(*stiff)).inverse()
    a, b, c = lower
    solved = [[row.x * a[i] + row.y * b[i] + row.z * c[i] for i in range(2 + moving)] for row in inverse]
    moved, turned = arm.velocity_columns_to_twist(slope)[1], arm.force_rows_to_wrench(slope)[1]
    direct = [[slope, moved, slope], [turned, arm.force_rows_to_wrench(moved)[1], turned], [slope, moved, slope]]

    def rest(i: int, j: int) -> Matrix:
        rows = []
        for name, row in zip("xyz", direct[i][j], strict=True):
            for own, given in zip(upper, solved, strict=True):
                row = row - getattr(own[i], name) * given[j]
            rows.append(row)
        return Matrix(*rows)

    return LegElimination(upper, solved, inverse, [[rest(i, j) for j in range(2 + moving)] for i in range(2 + moving)])


def _add_standing_legs(blocks: "BlockMatrix", arm: BodyContactJacobian, leg_block: list[list[Matrix]]) -> None:
    """Add the stiffness that free bodies feel from the legs that stand on them."""
    ground = 2
    for i in range(2):
        for j, column in enumerate(arm.velocity_columns_to_twist(leg_block[i][ground])):
            blocks.add_block(i, 2 * arm.body + j, column.sum_last_axis())
        for j, row in enumerate(arm.force_rows_to_wrench(leg_block[ground][i])):
            blocks.add_block(2 * arm.body + j, i, row.sum_last_axis())
    _couple(blocks, arm, arm, leg_block[ground][ground])


def _add_free_contacts(
    blocks: "BlockMatrix", touching: tuple[BodyContactJacobian, ...], slope: Matrix, turning: Matrix | None
) -> None:
    """Add the stiffness of contacts of free bodies with the world and each other; `turning` resists rolling."""
    for one in touching:
        for other in touching:
            _couple(blocks, one, other, slope)
            if turning is not None:
                shared = turning.scale(one.sign).scale(other.sign)  # pyright: ignore
                blocks.add_block(2 * one.body + 1, 2 * other.body + 1, shared.sum_last_axis())


def _couple(blocks: "BlockMatrix", first: BodyContactJacobian, second: BodyContactJacobian, slope: Matrix) -> None:
    for i, row in enumerate(first.force_rows_to_wrench(slope)):
        for j, block in enumerate(second.velocity_columns_to_twist(row)):
            blocks.add_block(2 * first.body + i, 2 * second.body + j, block.sum_last_axis())


class BlockMatrix:
    """Symmetric matrix of 3x3 blocks; missing blocks are zero."""

    def __init__(self) -> None:
        self.blocks: dict[tuple[int, int], Matrix] = {}

    def add_block(self, i: int, j: int, block: Matrix) -> None:
        """Add a 3x3 block to the block at row `i` and column `j`."""
        self.blocks[i, j] = self.blocks[i, j].plus(block) if (i, j) in self.blocks else block

    def solve(self, right: list[Vector]) -> list[Vector]:
        """Solve by Gaussian elimination without pivoting, which is stable as the diagonal dominates."""
        n, a, right = len(right), dict(self.blocks), list(right)
        inverses: list[Matrix] = []
        for i in range(n):
            inverses.append(a[i, i].inverse())
            below = [j for j in range(i + 1, n) if (j, i) in a]
            beside = [k for k in range(i + 1, n) if (i, k) in a]
            for j in below:
                factor = a[j, i].times(inverses[i])
                for k in beside:
                    less = factor.times(a[i, k])
                    a[j, k] = a[j, k].minus(less) if (j, k) in a else less.negative
                right[j] = right[j] - factor @ right[i]
        x = list(right)
        for i in reversed(range(n)):
            for k in range(i + 1, n):
                if (i, k) in a:
                    x[i] = x[i] - a[i, k] @ x[k]
            x[i] = inverses[i] @ x[i]
        return x
