"""The file ``bridge.yaml``: sensors and their topics."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from ..core import InputError, brief, load_yaml, load_yaml_model
from ..sensing.config_fields import Positive
from .transports.open_node import Transport
from .transports.session import ROUTER, RosOptions
from .wire.graph import check_node, resolve_name


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid")


class NodeSection(_Section):
    """Connection of the node; see :class:`visuohaptic.ros.RosOptions`."""

    name: str = "visuohaptic"
    namespace: str = "/"
    transport: Transport = "zenoh"
    domain: Annotated[int, Field(ge=0, le=232)] | None = None  #: by default that of ROS_DOMAIN_ID
    type_hashes: bool = True  #: false for Humble, which has none
    connect: list[str] = [ROUTER]  #: routers or peers; empty: wait for others to connect
    listen: list[str] = ["tcp/127.0.0.1:0"]  #: addresses on which peers may connect; port 0 is any free port
    zenoh_config: str | None = None  #: zenoh configuration file (JSON5) instead of the two above
    patience_s: Positive = 3.0  #: time-out for a router [s]

    @model_validator(mode="after")
    def _names(self) -> NodeSection:
        check_node(self.namespace, self.name)
        return self

    def options(self, folder: Path) -> RosOptions:
        """Convert to options; file names are relative to ``folder``.

        Parameters
        ----------
        folder
            Folder of ``bridge.yaml``, which file names are relative to.
        """
        chosen = self.model_dump(exclude={"name", "transport", "connect", "listen", "zenoh_config"})
        file = None if self.zenoh_config is None else folder / self.zenoh_config
        return RosOptions(connect=tuple(self.connect), listen=tuple(self.listen), zenoh_config=file, **chosen)


class SensorSection(_Section):
    """One sensor."""

    name: Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_]*$")]
    config: str  #: sensor.yaml or scene.yaml; its field ``kind`` determines the sensor type
    image: str  #: image topic; raw, or compressed if its name ends in /compressed
    frame: str | None = None  #: coordinate frame of the messages; by default the sensor's name
    odometry: str | None = None  #: nav_msgs/Odometry, for a scene
    zero_frames: Annotated[int, Field(ge=0, le=10_000)] = (
        0  #: number of initial frames used for zeroing; not stored
    )
    queue: Annotated[int, Field(ge=1, le=100)] = 2  #: queued frames while one is processed

    @model_validator(mode="after")
    def _topics(self) -> SensorSection:
        for topic in (self.image, self.odometry):
            if topic:
                resolve_name(topic)
        return self


class BridgeConfig(_Section):
    """Fields of ``bridge.yaml``; file names are relative to its folder."""

    kind: Literal["ros_bridge"] = "ros_bridge"
    node: NodeSection = NodeSection()
    sensors: Annotated[list[SensorSection], Field(min_length=1, max_length=16)]
    stale_s: Positive = 0.5  #: time without image after which ``stale`` is published

    @model_validator(mode="after")
    def _names(self) -> BridgeConfig:
        names = [sensor.name for sensor in self.sensors]
        if repeated := sorted({name for name in names if names.count(name) > 1}):
            raise ValueError(f"sensor names must be distinct, {', '.join(repeated)} occurs twice")
        return self

    @classmethod
    def load(cls, path: Path | str) -> BridgeConfig:
        """Load the file.

        Parameters
        ----------
        path
            Configuration file of a bridge, such as ``bridge.yaml``.

        Raises
        ------
        InputError
            Lists all invalid fields.
        """
        return load_yaml_model(path, cls)


def sensor_kind(path: Path) -> str:
    """``foam``, ``beam`` or ``scene``, according to the sensor's configuration file.

    Parameters
    ----------
    path
        Configuration file of a sensor.
    """
    data: Any = load_yaml(path)
    found = data.get("kind") if isinstance(data, dict) else None
    if found not in ("foam", "beam", "scene"):
        raise InputError(path, f"found {brief(found)}, expected foam, beam or scene", field="kind")
    return str(found)
