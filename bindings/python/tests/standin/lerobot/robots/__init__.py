"""A stand-in for the part of LeRobot that a plugin derives from, with the same names. LeRobot itself needs PyTorch."""

from __future__ import annotations

import abc
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar, Optional, TypeVar

T = TypeVar("T", bound="type[RobotConfig]")


@dataclass(kw_only=True)
class RobotConfig:
    id: Optional[str] = None
    choices: ClassVar[dict[str, type[RobotConfig]]] = {}

    @classmethod
    def register_subclass(cls, name: str) -> Callable[[T], T]:
        def register(subclass: T) -> T:
            cls.choices[name] = subclass
            return subclass

        return register


class Robot(abc.ABC):
    config_class: type[RobotConfig]
    name: str

    def __init__(self, config: RobotConfig) -> None:
        self.id = config.id

    @property
    @abc.abstractmethod
    def observation_features(self) -> dict[str, type]: ...

    @property
    @abc.abstractmethod
    def action_features(self) -> dict[str, type]: ...

    @property
    @abc.abstractmethod
    def is_connected(self) -> bool: ...

    @abc.abstractmethod
    def connect(self, calibrate: bool = True) -> None: ...

    @property
    @abc.abstractmethod
    def is_calibrated(self) -> bool: ...

    @abc.abstractmethod
    def calibrate(self) -> None: ...

    @abc.abstractmethod
    def configure(self) -> None: ...

    @abc.abstractmethod
    def get_observation(self) -> dict[str, Any]: ...

    @abc.abstractmethod
    def send_action(self, action: dict[str, Any]) -> dict[str, Any]: ...

    @abc.abstractmethod
    def disconnect(self) -> None: ...
