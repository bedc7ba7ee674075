"""Lengths and angles in a robot file, with units and ranges."""

import math
from typing import Annotated

from pydantic import Field

from hdsp.base.settings import NotNegative, Positive, unit

_LARGEST = 10.0  # m; a larger length is in another unit

Metres = Annotated[float, Field(ge=-_LARGEST, le=_LARGEST), unit("m")]
PositiveMetres = Annotated[Positive, Field(le=_LARGEST), unit("m")]
NotNegativeMetres = Annotated[NotNegative, Field(le=_LARGEST), unit("m")]
NotNegativeRadians = Annotated[NotNegative, unit("rad")]
#: Inclination of the ground. Less than a millimetre per metre is none that a map could show.
Inclination = Annotated[float, Field(ge=0.001, lt=math.pi / 2), unit("rad")]
#: Inclination of the base.
Lean = Annotated[NotNegative, Field(lt=math.pi / 2), unit("rad")]
#: Factor on a cost; ``.inf`` in a robot file: not possible.
FactorOrNever = Annotated[float, Field(gt=0, allow_inf_nan=True)]
#: Angle between heading and direction.
Deviation = Annotated[float, Field(gt=0, le=math.pi), unit("rad")]
