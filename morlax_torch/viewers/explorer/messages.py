"""What browsers may send: the pose of their camera, and values that the page's widgets offer."""

import sys
from collections.abc import Mapping
from typing import Annotated

import msgspec
from viser import (
    GuiButtonGroupHandle,
    GuiCheckboxHandle,
    GuiDropdownHandle,
    GuiSliderHandle,
    GuiTextHandle,
)

LONGEST = 200  # characters in a text field

Finite = Annotated[float, msgspec.Meta(ge=-sys.float_info.max, le=sys.float_info.max)]
Vector = tuple[Finite, Finite, Finite]


class Pose(msgspec.Struct, tag="ViewerCameraMessage"):
    """viser's message of this name, sent when a camera moves."""

    wxyz: tuple[Finite, Finite, Finite, Finite]
    position: Vector
    look_at: Vector
    up_direction: Vector
    fov: Finite
    near: Finite
    far: Finite
    image_height: int
    image_width: int


class Setting(msgspec.Struct, tag="GuiUpdateMessage"):
    """viser's message of this name, sent when a user changes a widget or presses a button."""

    class Updates(msgspec.Struct):
        value: bool | Finite | str

    uuid: str  # of the widget
    updates: Updates


def accepted(raw: bytes, widgets: Mapping[str, object]) -> bytes | None:
    """Check a message before viser reads it.

    viser would set any attribute of a widget to any value, and serve messages that the page never
    sends, such as a request to publish it on the internet.

    Args:
        raw: the message; viser's page sends bytes, but others may send text.
        widgets: the page's widgets by viser's uuid.

    Returns:
        The message with its value clamped to the widget's limits; None if the page would not send
        it.
    """
    try:
        fields = msgspec.msgpack.decode(raw)
        message = msgspec.convert(fields, Pose | Setting)
    except (TypeError, ValueError, RecursionError):
        return None
    if isinstance(message, Pose):
        return msgspec.msgpack.encode(fields)  # newer versions of viser may add some
    value = offered(widgets.get(message.uuid), message.updates.value)
    if value is None:
        return None
    return msgspec.msgpack.encode(Setting(message.uuid, Setting.Updates(value)))


def offered(widget: object, value: bool | float | str) -> bool | float | str | None:
    """Return a value as the widget offers it, a number clamped to its limits; otherwise None."""
    match widget, value:
        case GuiCheckboxHandle(), bool():
            return value
        case GuiSliderHandle(), float():
            return min(max(value, widget.min), widget.max)
        case GuiDropdownHandle() | GuiButtonGroupHandle(), str() if value in widget.options:
            return value
        case GuiTextHandle(), str() if len(value) <= LONGEST:
            return value
    return None
