"""Names in rmw_zenoh: topics as key expressions, nodes and their endpoints as liveliness tokens.

A publisher and a subscription are matched if their key expressions are equal: domain, topic, type and
type hash. Liveliness tokens announce them to others, for ``ros2 topic list`` and similar tools.
Implemented from the design of rmw_zenoh (its ``docs/design.md``), Jazzy to Rolling.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Self

from ...core import InputError, brief, check_ranges, within

_SPACE = "@ros2_lv"
_WORD = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
#: Default queue length of rmw_zenoh; omitted in tokens.
_DEFAULT_DEPTH = 42


class EntityKind(StrEnum):
    """Kind of entity that a token represents."""

    NODE = "NN"
    PUBLISHER = "MP"
    SUBSCRIPTION = "MS"
    SERVICE = "SS"
    CLIENT = "SC"


@dataclass(frozen=True, slots=True)
class Qos:
    """Quality of service, limited to the settings used here."""

    reliable: bool = True
    latched: bool = False  #: late subscribers receive the last messages (``TRANSIENT_LOCAL``)
    depth: int = field(default=10, metadata=within(1, 100_000))  #: number of messages kept

    def __post_init__(self) -> None:
        check_ranges(self)

    def key(self) -> str:
        """Representation in a token: defaults of rmw_zenoh are omitted."""
        depth = "" if self.depth == _DEFAULT_DEPTH else str(self.depth)
        return f"{'' if self.reliable else 2}:{1 if self.latched else ''}:,{depth}:,:,:,,"

    @classmethod
    def parse(cls, key: str) -> Self:
        """Parse from a token; unused settings are ignored.

        Parameters
        ----------
        key
            Last part of a token.
        """
        parts = key.split(":")
        history = parts[2].split(",") if len(parts) >= 6 else []
        numbers = [*parts[:2], *history]
        if len(history) != 2 or not all(part.isdecimal() or not part for part in numbers):
            raise InputError("liveliness token", f"found quality of service {brief(key)}")
        depth = int(history[1] or _DEFAULT_DEPTH) or _DEFAULT_DEPTH
        return cls(parts[0] not in ("0", "2"), parts[1] == "1", min(depth, 100_000))


#: For data that is valid until replaced: late subscribers receive the last message.
LATCHED = Qos(latched=True, depth=1)


@dataclass(frozen=True, slots=True)
class Entity:
    """A node, or a publisher or subscription of a node."""

    domain: int
    session: str  #: id of the zenoh session
    node_id: int
    entity_id: int
    kind: EntityKind
    namespace: str  #: ``/``, or for example ``/robot1``
    node: str
    topic: str = ""  #: for example ``/robot1/camera/image``; empty for a node
    datatype: str = ""  #: for example ``sensor_msgs/msg/Image``
    type_hash: str = ""
    qos: Qos = Qos()

    def token(self) -> str:
        """Liveliness token of the entity."""
        words = [_SPACE, str(self.domain), self.session, str(self.node_id), str(self.entity_id)]
        # The enclave of a system without SROS.
        words += [self.kind.value, "%", _mangled(self.namespace), _mangled(self.node)]
        if self.kind is not EntityKind.NODE:
            words += [_mangled(self.topic), to_dds(self.datatype), self.type_hash, self.qos.key()]
        return "/".join(words)

    @classmethod
    def parse(cls, token: str) -> Self:
        """Parse the token of any node.

        Parameters
        ----------
        token
            Key expression ``@ros2_lv/...``.

        Raises
        ------
        InputError
            It is not a token of a known version.
        """
        words = token.split("/")
        if len(words) not in (9, 13) or words[0] != _SPACE or not all(words):
            raise InputError(
                "liveliness token", f"found {brief(token)}, expected {_SPACE}/ and 8 or 12 parts"
            )
        try:
            kind = EntityKind(words[5])
            domain, node_id, entity_id = int(words[1]), int(words[3]), int(words[4])
        except ValueError as error:
            problem = f"found {brief(token)}, expected numbers as domain and ids, and one of {[*map(str, EntityKind)]}"
            raise InputError("liveliness token", problem) from error
        if (kind is EntityKind.NODE) != (len(words) == 9):
            raise InputError(
                "liveliness token", f"found {brief(token)}, {len(words)} parts do not fit {kind}"
            )
        namespace, node = words[7].replace("%", "/"), words[8].replace("%", "/")
        if kind is EntityKind.NODE:
            return cls(domain, words[2], node_id, entity_id, kind, namespace, node)
        topic, datatype = words[9].replace("%", "/"), from_dds(words[10])
        qos = Qos.parse(words[12])
        return cls(
            domain, words[2], node_id, entity_id, kind, namespace, node, topic, datatype, words[11], qos
        )


def all_tokens(domain: int) -> str:
    """Key expression of all tokens in a domain.

    Parameters
    ----------
    domain
        ROS_DOMAIN_ID.
    """
    return f"{_SPACE}/{domain}/**"


def topic_key(domain: int, topic: str, datatype: str, type_hash: str) -> str:
    """Key expression of a topic.

    Parameters
    ----------
    domain
        ROS_DOMAIN_ID.
    topic
        Absolute name.
    datatype
        Such as ``std_msgs/msg/String``.
    type_hash
        ``RIHS01_...``, or the placeholder for none.

    Examples
    --------
    >>> topic_key(0, "/chatter", "std_msgs/msg/String", "RIHS01_df66")
    '0/chatter/std_msgs::msg::dds_::String_/RIHS01_df66'
    """
    return f"{domain}/{topic.strip('/')}/{to_dds(datatype)}/{type_hash}"


def resolve_name(name: str, namespace: str = "/", node: str = "") -> str:
    """Absolute name of a topic: ``/a`` is unchanged, ``a`` is in the namespace, ``~/a`` is private to the node.

    Parameters
    ----------
    name
        Given name.
    namespace
        Absolute namespace of the node.
    node
        Absolute name of the node.

    Raises
    ------
    InputError
        It is not a ROS name: letters, digits and ``_`` between slashes, no digit first, no ``__``.
    """
    if name.startswith("~/"):
        name = f"{node}/{name[2:]}"
    whole = name if name.startswith("/") else f"{namespace.rstrip('/')}/{name}"
    words = whole.split("/")[1:]
    if not all(_WORD.fullmatch(word) for word in words) or "__" in whole:
        raise InputError(
            "name",
            f"found {name!r}, expected words of letters, digits and _ between slashes, as /camera/image",
        )
    return whole


def check_node(namespace: str, node: str) -> None:
    """Reject names that ROS does not allow.

    Parameters
    ----------
    namespace
        Absolute namespace of the node.
    node
        Name of the node.
    """
    if not _WORD.fullmatch(node) or "__" in node:
        raise InputError("node name", f"found {node!r}, expected letters, digits and _, no digit first")
    if namespace != "/":
        resolve_name(namespace if namespace.startswith("/") else f"{namespace}!")


def _mangled(name: str) -> str:
    return name.replace("/", "%")


def to_dds(datatype: str) -> str:
    """Name of a type in DDS, ``std_msgs::msg::dds_::String_``.

    Parameters
    ----------
    datatype
        Such as ``std_msgs/msg/String``.
    """
    package, middle, short = datatype.split("/")
    return f"{package}::{middle}::dds_::{short}_"


def from_dds(name: str) -> str:
    """Name of a type in ROS, ``std_msgs/msg/String``.

    Parameters
    ----------
    name
        Such as ``std_msgs::msg::dds_::String_``.
    """
    return name.replace("::dds_::", "::").removesuffix("_").replace("::", "/")
