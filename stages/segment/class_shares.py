"""How often the classes occur: what training weighs them up by, and what labelling takes back."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from salpcc.schemas.labels import CLASSES

_NAMES = [c.name for c in CLASSES[1:20]]

# Shares of the points of the 19 classes in SemanticKITTI, in the order of CLASSES (its published statistics).
SHARES: NDArray[np.float32] = np.array(
    [
        4.26e-2, 1.7e-4, 4.0e-4, 1.96e-3, 2.3e-3, 3.4e-4, 1.3e-4, 4e-5, 1.99e-1, 1.47e-2,
        1.44e-1, 3.9e-3, 1.33e-1, 7.2e-2, 2.67e-1, 6.0e-3, 7.8e-2, 2.9e-3, 6.2e-4,
    ],
    np.float32,
)  # fmt: skip

_HEAVIEST = np.float32(
    30.0
)  # before the mean is taken out: a dozen bicyclists are no reason to learn them by heart

# People and two-wheelers weigh more in training, and are pasted into crops some twenty times as often as streets
# hold them; a network so taught sees a bicycle in every bush. Labelling takes a part of that back (logit adjustment,
# Menon et al., ICLR 2021): scans with boxes teach that bushes are none. Vehicles are left as they are: what is taken
# from trucks and buses is lost (measured).
_PASTED_TOO_OFTEN = 5.0
_PASTED = [name in ("bicycle", "motorcycle", "person", "bicyclist", "motorcyclist") for name in _NAMES]
AS_IN_STREETS = np.log(np.where(_PASTED, 1.0 / _PASTED_TOO_OFTEN, 1.0)).astype(np.float32)


def training_weights(root: float = 4.0) -> NDArray[np.float32]:
    """Return the weight ``(19,)`` of each class in the loss: root of the inverse share, mean 1 over the points."""
    weights = np.minimum(SHARES ** np.float32(-1.0 / root), _HEAVIEST)
    return weights / (weights * SHARES).sum()
