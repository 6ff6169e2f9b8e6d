"""The base class of every part of meta.json and result.json: typed, frozen, written with the keys that were set."""

from __future__ import annotations

import math
from enum import Enum
from typing import Annotated, Any, Final, Self, TypeVar, cast

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    GetJsonSchemaHandler,
    JsonValue,
    SerializerFunctionWrapHandler,
    Strict,
    StrictInt,
    StrictStr,
    model_serializer,
)
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema

VERSION: Final = 1  # of both files: their key ``schema``

JsonObject = dict[str, JsonValue]
_T = TypeVar("_T")


class Mark(Enum):
    """What a key's type says about the key itself."""

    NOT_IN_EACH_FILE = "a file of this version may lack the key"
    NEVER_NULL = "the file leaves the key out instead of writing null"


NOT_IN_EACH_FILE: Final = Mark.NOT_IN_EACH_FILE


def _known(value: object) -> object:
    return None if isinstance(value, float) and not math.isfinite(value) else value


Real = Annotated[float, Strict()]
"""A number; a text or a boolean is none."""
Number = Annotated[float | None, Strict(), BeforeValidator(_known)]
"""A number, or None (JSON: null) if it is not known; nan and infinity become None."""
Flag = Annotated[bool, Strict()]
Sometimes = Annotated[_T | None, Mark.NOT_IN_EACH_FILE, Mark.NEVER_NULL]
"""A key that the file leaves out if it has no value."""
Count = StrictInt
Text = StrictStr


def key(meaning: str, without: Any = None) -> Any:
    """A key that a file may lack: what it means, and its value then. One that no file lacks is a ``Field``."""
    return Field(without, description=meaning)


class Part(BaseModel):
    """A part of a file. Equal parts write equal JSON.

    A part keeps keys that this version does not know, and writes them again; ``unknown_keys`` names them.
    """

    model_config = ConfigDict(frozen=True, extra="allow", allow_inf_nan=False, populate_by_name=True, defer_build=True)

    @classmethod
    def of(cls, one: object, **others: object) -> Self:
        """The part with all that ``one`` has under the names of its keys; ``others`` go before that."""
        own = {name: getattr(one, name) for name in cls.model_fields if name not in others and hasattr(one, name)}
        return cls.model_validate(own | others)

    def as_json(self) -> JsonObject:
        """The part as JSON: the keys that were set, in the order of the class; unknown keys last."""
        return cast(JsonObject, self.model_dump(mode="json", by_alias=True, exclude_unset=True))

    @model_serializer(mode="wrap")
    def _without_what_is_not(self, serialise: SerializerFunctionWrapHandler) -> dict[str, object]:
        written: dict[str, object] = serialise(self)
        for name, field in type(self).model_fields.items():
            if Mark.NEVER_NULL in field.metadata and getattr(self, name) is None:
                written.pop(name, None)
        return written

    def says(self, name: str) -> bool:
        """Whether the key was set, even if to null."""
        return name in self.model_fields_set

    @classmethod
    def __get_pydantic_json_schema__(cls, core_schema: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        """Require in the JSON Schema the keys that this version always writes; reading an older file needs none."""
        found = handler(core_schema)
        schema = handler.resolve_ref_schema(found)
        required = [
            field.alias or name for name, field in cls.model_fields.items() if NOT_IN_EACH_FILE not in field.metadata
        ]
        schema["required"] = required
        if not required:
            del schema["required"]
        return found
