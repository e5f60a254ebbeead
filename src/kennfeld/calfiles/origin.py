"""What a set of parameters keeps of an image that it was read from."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:  # whoever has no image loads neither
    from kennfeld.calfiles.a2l.objects import A2l
    from kennfeld.calfiles.images.image import Image

__all__ = ["Flash"]


@dataclass(frozen=True, eq=False)
class Flash:
    """Where a set of parameters was read from: an image, and the A2L file that describes it."""

    a2l: "A2l"
    image: "Image"
