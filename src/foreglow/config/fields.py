"""The base of all configurations: strict frozen fields, and errors of one line."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from typing import Any, Self, TypeVar

from pydantic import BaseModel, BeforeValidator, ConfigDict, ValidationError, field_validator
from pydantic_core import PydanticCustomError

from foreglow.numbers import plain
from foreglow.wording import shortened

MAX_NUMBER = 1e12
"""No number of a configuration is larger: what is computed from larger ones may overflow."""


def _integer(value: Any) -> Any:
    if type(value) is not int:
        raise PydanticCustomError("int_type", "Input should be a valid integer")
    return value


ONE_OF = BeforeValidator(_integer)
"""For a field that is one of some integers: `Literal` compares by value, also if strict, so that `true` were 1."""


class PlainModel(BaseModel):
    """A model whose fields take NumPy's numbers and truth values as Python's own, which they become.

    No validator of pydantic's does so: in front of strict fields, it would have lists of JSON refused.
    """

    def __init__(self, /, **fields: Any) -> None:
        super().__init__(**self._plain(fields))

    __init__.__pydantic_base_init__ = True  # type: ignore[attr-defined]  # JSON, and dictionaries, do not come by it

    @classmethod
    def model_validate(cls, obj: Any, **options: Any) -> Self:
        """As pydantic's."""
        return super().model_validate(cls._plain(obj), **options)

    @classmethod
    def _plain(cls, fields: Any) -> Any:
        """The fields as they are checked, from those that were given in Python."""
        return plain(fields)


class FrozenModel(PlainModel):
    """A frozen set of parameters.

    Unknown fields, NaN, infinity, numbers above `MAX_NUMBER` and values of another type are errors; NumPy's numbers
    are no other type.
    """

    # Strict: `kappa = true` and `gap_px = "4"` are mistakes, not numbers.
    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)

    def model_copy(self, *, update: Mapping[str, Any] | None = None, deep: bool = False) -> Self:
        """As pydantic's, but what is changed is checked as where the model is made.

        Raises:
            ValueError: If a field is unknown or its value is not allowed, also beside the others; the message names the
                first such field.
        """
        if update:
            try:
                whole = type(self).model_validate(dict(self) | dict(update))
            except ValidationError as error:
                raise ValueError(_first_complaint(type(self), error)) from error
            update = {name: getattr(whole, name) for name in update}
        return super().model_copy(update=update, deep=deep)

    @field_validator("*")
    @classmethod
    def _check_numbers(cls, value: Any) -> Any:
        if any(MAX_NUMBER < abs(number) < math.inf for number in _floats(value)):
            raise PydanticCustomError("too_large", f"expected numbers of at most {MAX_NUMBER:g}")
        return value


def _floats(value: Any) -> Iterator[float]:
    """The floating-point numbers in the value of a field; a model in it has checked its own."""
    if isinstance(value, float):
        yield value
    elif isinstance(value, list | tuple):
        for part in value:
            yield from _floats(part)


Model = TypeVar("Model", bound=BaseModel)


def validated(model: type[Model], fields: Any, origin: str) -> Model:
    """`fields` as a `model`.

    Raises:
        ValueError: If a field is unknown, missing, of the wrong type or out of range; the message names `origin`, the
            first such field and what was expected.
    """
    try:
        return model.model_validate(fields)
    except ValidationError as error:
        raise ValueError(f"{origin}: {_first_complaint(model, error)}") from error


def _first_complaint(model: type[BaseModel], error: ValidationError) -> str:
    """One line about the first wrong field: what was expected, and what was found."""
    first = error.errors()[0]
    field = ".".join(str(part) for part in first["loc"])
    if first["type"] == "value_error":  # a check of our own, which names the field in the one that it is of, if any
        words = str(first["ctx"]["error"])
        return words if not field else f"{field}: {words}" if words.startswith("expected ") else f"{field}.{words}"
    field = field or "configuration"
    if first["type"] == "missing" and isinstance(first["input"], dict):
        return f"{field}: missing"
    if first["type"] == "extra_forbidden":
        section = model.model_fields.get(str(first["loc"][0])) if len(first["loc"]) == 2 else None
        owner = model if section is None else section.annotation
        known = owner.model_fields if isinstance(owner, type) and issubclass(owner, BaseModel) else {}
        return f"{field}: unknown" + (f", expected one of {', '.join(known)}" if known else "")
    return f"{field}: {_in_toml(first['msg'])}, got {shortened(first['input'])}"


def _in_toml(words: str) -> str:
    """A message of pydantic in the words of TOML.

    >>> _in_toml("Input should be a valid dictionary or instance of Camera"), _in_toml("Input should be a valid tuple")
    ('Input should be a table', 'Input should be a list')
    """
    words = re.sub(r"a valid dictionary( or instance of \w+)?", "a table", words)
    words = re.sub("a valid (tuple|list)", "a list", words.replace(" after validation", ""))
    return re.sub("^Tuple should", "List should", words).replace("Field required", "expected one more value")
