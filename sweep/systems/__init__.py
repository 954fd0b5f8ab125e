"""What can be studied: each system has a module, which alone knows more of it than the contract in `base`."""

from collections.abc import Mapping
from typing import Any

from sweep.systems import hexapod
from sweep.systems.base import Kinds, Nominal


def nominal(values: Mapping[str, Any], kinds: Kinds) -> Nominal:
    """The system that plain configuration `values` speak of, all of them checked. Raises `InputError`.

    `kinds` are the classes that a group's `kind` chooses from, those of users too.
    """
    return hexapod.nominal(values, kinds)
