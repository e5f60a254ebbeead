"""The image that a set was read from."""

from typing import TYPE_CHECKING

from kennfeld.base.lazy_dataclass import dataclass

if TYPE_CHECKING:
    from kennfeld.calfiles.a2l.objects import A2l
    from kennfeld.calfiles.flash.image import Image


@dataclass(frozen=True, eq=False)
class FlashOrigin:
    """The image that a set was read from, and the A2L file that describes it."""

    a2l: "A2l"
    image: "Image"
