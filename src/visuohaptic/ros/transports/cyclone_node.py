"""A node on DDS without ROS: Eclipse Cyclone DDS for Python, with the names and types of ROS 2.

Topics are prefixed with ``rt``, types are mangled and key-less, data is XCDR1, the type hash is in the user
data of an endpoint, and ``ros_discovery_info`` contains the node of each endpoint (rmw_dds_common).
"""

from __future__ import annotations

import keyword
import os
import re
import threading
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from ...core.errors import DeviceError, InputError, needs
from ...core.files import MAX_HAND_BYTES, read_text
from ...core.resources import end_thread
from ..wire import Attachment, Field, MessageType, Shape, decode, encode, parse_definition
from ..wire.graph import LATCHED, Entity, EntityKind, Qos, from_dds
from .session import RosOptions, check_security, shown_error
from .topic_node import Outlet, RosSubscription, TopicNode

#: Maximum number of nodes and endpoints read from the graph.
_MAX_TOLD = 10_000
#: What is not part of a configuration.
_COMMENT = re.compile(r"<!--.*?-->", re.DOTALL)

_DISCOVERY = parse_definition(
    "rmw_dds_common/msg/ParticipantEntitiesInfo",
    "Gid gid\nNodeEntitiesInfo[] node_entities_info_seq\n===\nMSG: rmw_dds_common/Gid\nuint8[16] data\n===\n"
    "MSG: rmw_dds_common/NodeEntitiesInfo\nstring<=256 node_namespace\nstring<=256 node_name\n"
    "Gid[] reader_gid_seq\nGid[] writer_gid_seq\n",
)


def _idl_type(field: Field, structs: dict[str, Any]) -> Any:
    """The type of a field in the DDS binding."""
    from cyclonedds.idl import types

    plain = {"string": str, "bool": bool, "byte": types.byte, "char": types.uint8}
    kind = structs.get(field.kind) or plain.get(field.kind) or getattr(types, field.kind)
    if field.kind == "string" and field.text_capacity:
        kind = types.bounded_str[field.text_capacity]
    if field.shape is Shape.ARRAY:
        return types.array[kind, field.capacity]
    if field.shape is Shape.BOUNDED:
        return types.sequence[kind, field.capacity]
    return types.sequence[kind] if field.shape is Shape.SEQUENCE else kind


def _raw_type(kind: MessageType) -> Any:
    """A DDS type with the message's structure, whose samples are CDR bytes written by this library."""
    from cyclonedds.idl import make_idl_struct

    structs: dict[str, Any] = {}

    def struct(name: str) -> Any:
        for field in kind.parts[name]:
            if field.nested and field.kind not in structs:
                struct(field.kind)
        package, middle, short = name.split("/")
        fields = {
            f"_{field.name}" if keyword.iskeyword(field.name) else field.name: _idl_type(field, structs)
            for field in kind.parts[name]
        }
        structs[name] = make_idl_struct(f"{short}_", f"{package}.{middle}.dds_.{short}_", fields)
        return structs[name]

    def read(data: bytes, **_: Any) -> Any:
        sample = object.__new__(whole)
        sample.cdr = bytes(data)
        return sample

    whole = struct(kind.name)
    whole.serialize = lambda sample, **_: sample.cdr
    whole.deserialize = whole.deserialize_key = staticmethod(read)
    return whole


def _is_protected() -> bool:
    """Whether a configuration of ``CYCLONEDDS_URI``, files or XML after commas, has a section of security.

    Most have none: they name the interfaces of the network.
    """
    named = os.environ.get("CYCLONEDDS_URI", "")
    texts = [named]
    for part in named.split(","):
        if not part.lstrip().startswith("<"):
            with suppress(InputError):
                texts.append(read_text(part.strip().removeprefix("file://"), MAX_HAND_BYTES))
    return any(re.search(r"<Security[\s>]", _COMMENT.sub("", text)) for text in texts)


class CycloneNode(TopicNode):
    """A node over Cyclone DDS, without ROS; a context manager. Topics only.

    Parameters
    ----------
    name
        Name of the node.
    options
        Domain and namespace; the other fields apply to zenoh.

    Raises
    ------
    MissingExtraError
        The package cyclonedds is not installed.
    InputError
        ``ROS_SECURITY_ENABLE`` is set, and ``CYCLONEDDS_URI`` names no configuration that protects Cyclone DDS.
    DeviceError
        The domain cannot be joined.
    """

    def __init__(self, name: str = "visuohaptic", options: RosOptions | None = None) -> None:
        super().__init__(name, options)
        check_security(
            "cyclonedds", _is_protected(), "name a configuration with <Security> in CYCLONEDDS_URI"
        )
        with needs("cyclonedds", "dds", "DDS without ROS"):
            from cyclonedds.builtin import (
                BuiltinDataReader,
                BuiltinTopicDcpsParticipant,
                BuiltinTopicDcpsPublication,
                BuiltinTopicDcpsSubscription,
            )
            from cyclonedds.core import DDSException
            from cyclonedds.domain import DomainParticipant
            from cyclonedds.qos import Policy
            from cyclonedds.qos import Qos as DdsQos
        try:
            enclave = DdsQos(Policy.Userdata(b"enclave=/;"))
            self._participant = DomainParticipant(self.domain, qos=enclave)
        except DDSException as error:
            raise DeviceError(f"domain {self.domain} cannot be joined ({shown_error(error)})") from error
        self._endpoints: dict[EntityKind, list[Any]] = {EntityKind.PUBLISHER: [], EntityKind.SUBSCRIPTION: []}
        self._participants = BuiltinDataReader(self._participant, BuiltinTopicDcpsParticipant)
        self._told = (
            (EntityKind.PUBLISHER, BuiltinDataReader(self._participant, BuiltinTopicDcpsPublication)),
            (EntityKind.SUBSCRIPTION, BuiltinDataReader(self._participant, BuiltinTopicDcpsSubscription)),
        )
        self._discovery_type, topic = self._topic("ros_discovery_info", _DISCOVERY)
        self._nodes = self._reader(topic, _DISCOVERY, Qos(latched=True, depth=_MAX_TOLD))
        self._discovery = self._writer(topic, _DISCOVERY, LATCHED)
        self._announce()

    def _topic(self, name: str, kind: MessageType) -> tuple[Any, Any]:
        from cyclonedds.topic import Topic

        data_type = _raw_type(kind)
        return data_type, Topic(self._participant, name, data_type)

    def _qos(self, qos: Qos, kind: MessageType, *, keep_all: bool = False) -> Any:
        from cyclonedds.qos import Policy
        from cyclonedds.qos import Qos as DdsQos
        from cyclonedds.util import duration

        return DdsQos(
            Policy.Reliability.Reliable(duration(seconds=1))
            if qos.reliable
            else Policy.Reliability.BestEffort,
            Policy.Durability.TransientLocal if qos.latched else Policy.Durability.Volatile,
            Policy.History.KeepAll if keep_all else Policy.History.KeepLast(qos.depth),
            # A latched writer keeps this number for late subscribers.
            Policy.DurabilityService(0, Policy.History.KeepLast(qos.depth), -1, -1, -1),
            Policy.DataRepresentation(use_cdrv0_representation=True),
            Policy.Userdata(f"typehash={kind.type_hash()};".encode()),
        )

    def _writer(self, topic: Any, kind: MessageType, qos: Qos, *, wait: bool = False) -> Any:
        from cyclonedds.pub import DataWriter, Publisher

        # The binding allows the durability service only for writers.
        return DataWriter(Publisher(self._participant), topic, self._qos(qos, kind, keep_all=wait))

    def _reader(self, topic: Any, kind: MessageType, qos: Qos) -> Any:
        from cyclonedds.sub import DataReader

        return DataReader(self._participant, topic, self._qos(qos, kind))

    def _announce(self) -> None:
        """Announce which endpoints belong to this node."""

        def gids(kind: EntityKind) -> list[dict[str, bytes]]:
            return [{"data": entity.guid.bytes} for entity in self._endpoints[kind]]

        info = {
            "node_namespace": self.namespace,
            "node_name": self.name,
            "reader_gid_seq": gids(EntityKind.SUBSCRIPTION),
            "writer_gid_seq": gids(EntityKind.PUBLISHER),
        }
        message = {"gid": {"data": self._participant.guid.bytes}, "node_entities_info_seq": [info]}
        try:
            self._discovery.write(self._discovery_type.deserialize(encode(message, _DISCOVERY)))
        except Exception as error:  # exceptions of the binding have no common base class
            raise DeviceError(f"{self.name}: cannot be announced ({shown_error(error)})") from error

    def _outlet(self, topic: str, kind: MessageType, qos: Qos, wait: bool) -> Outlet:
        data_type, place = self._topic("rt" + topic, kind)
        # DDS deletes unreferenced entities: a closed writer remains until the node is closed.
        writers = self._endpoints[EntityKind.PUBLISHER]
        at = len(writers)
        writers.append(self._writer(place, kind, qos, wait=wait))
        self._announce()
        return Outlet(
            lambda data, _: writers[at].write(data_type.deserialize(data)),
            lambda: bool(writers[at].get_matched_subscriptions()),
        )

    def _listen(self, subscription: RosSubscription, kind: MessageType, qos: Qos) -> Callable[[], None]:
        from cyclonedds.core import InstanceState, ReadCondition, SampleState, ViewState, WaitSet
        from cyclonedds.util import duration

        _, place = self._topic("rt" + subscription.topic, kind)
        reader = self._reader(place, kind, qos)
        waiting, pause = WaitSet(self._participant), duration(milliseconds=100)
        waiting.attach(ReadCondition(reader, ViewState.Any | InstanceState.Any | SampleState.NotRead))
        counts: Counter[int] = Counter()  # by writer: DDS does not expose its message numbers
        end = threading.Event()

        def run() -> None:
            while not end.is_set():
                waiting.wait(pause)
                for sample in reader.take(qos.depth):
                    info = sample.sample_info
                    if info.valid_data:
                        counts[info.publication_handle] += 1
                        gid = info.publication_handle.to_bytes(16, "little")
                        beside = Attachment(counts[info.publication_handle], info.source_timestamp, gid)
                        subscription.take(sample.cdr, beside)

        thread = threading.Thread(target=run, name=f"{self.name} {subscription.topic}", daemon=True)
        self._endpoints[EntityKind.SUBSCRIPTION].append(reader)
        self._announce()
        thread.start()

        def undeclare() -> None:
            end.set()
            end_thread(thread)
            self._endpoints[EntityKind.SUBSCRIPTION].remove(reader)
            self._announce()

        return undeclare

    def graph(self, timeout_s: float = 1.0) -> tuple[Entity, ...]:
        """The graph as announced by other nodes so far; endpoints of unknown nodes have none.

        Parameters
        ----------
        timeout_s
            Not used: returns what is currently known.
        """
        here = {sample.key.bytes for sample in _alive(self._participants)}
        newest = {}
        for sample in self._nodes.read(_MAX_TOLD):
            if sample.sample_info.valid_data:
                info = decode(sample.cdr, _DISCOVERY, "ros_discovery_info")
                newest[bytes(info.gid.data)] = info
        owners: dict[bytes, tuple[str, str]] = {}
        found = []
        for gid in sorted(newest.keys() & here):
            for node in newest[gid].node_entities_info_seq:
                place = (node.node_namespace, node.node_name)
                found.append(self._seen(EntityKind.NODE, place))
                owners |= {bytes(each.data): place for each in (*node.reader_gid_seq, *node.writer_gid_seq)}
        for kind, reader in self._told:
            for sample in _alive(reader):
                if sample.topic_name.startswith("rt/") and sample.type_name.endswith("_"):
                    place = owners.get(sample.key.bytes, ("/", ""))
                    found.append(self._seen(kind, place, *_told_endpoint(sample)))
        return tuple(found)

    def _leave(self) -> None:
        for endpoints in self._endpoints.values():
            endpoints.clear()
        del self._discovery, self._nodes, self._told, self._participants, self._participant


def _alive(reader: Any) -> list[Any]:
    """Currently alive instances reported by the reader of a built-in topic."""
    from cyclonedds.core import InstanceState

    told = reader.read(_MAX_TOLD)
    return [sample for sample in told if sample.sample_info.instance_state == InstanceState.Alive]


def _told_endpoint(sample: Any) -> tuple[str, str, str, Qos]:
    """Topic, type, type hash and quality of service of a discovered endpoint."""
    from cyclonedds.qos import Policy

    qos = sample.qos
    data = bytes(qos[Policy.Userdata].data).decode(errors="replace") if Policy.Userdata in qos else ""
    reliable = Policy.Reliability in qos and qos[Policy.Reliability] != Policy.Reliability.BestEffort
    latched = Policy.Durability in qos and qos[Policy.Durability] == Policy.Durability.TransientLocal
    topic, datatype = sample.topic_name.removeprefix("rt"), from_dds(sample.type_name)
    return topic, datatype, data.removeprefix("typehash=").rstrip(";\0"), Qos(reliable, latched)
