"""Images of a control unit's memory: Intel HEX and Motorola S-records, read and changed without losing a byte."""

from kennfeld.calfiles.images.image import Image
from kennfeld.calfiles.images.reading import read_image, recognises_image

__all__ = ["Image", "read_image", "recognises_image"]
