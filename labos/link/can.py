"""CAN: single messages with python-can, and objects of CANopen nodes (SDO) with canopen."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

import msgspec

from labos.errors import DeviceError, LinkLost, NoReply, NotConnected, StrayReply
from labos.link.life import Life
from labos.link.transcript import note
from labos.link.wire import needs

if TYPE_CHECKING:
    import can

ERROR_PAUSE_S = 0.1


class CanMessage(msgspec.Struct, frozen=True):
    """A frame on the bus. A transcript shows it as ``601#4000100000000000``."""

    id: int
    data: bytes = b""
    extended: bool = False

    def __str__(self) -> str:
        return f"{self.id:0{8 if self.extended else 3}X}#{self.data.hex().upper()}"


class _Bus(Life):
    """A CAN interface. ``settings`` are those of python-can (``interface``, ``channel``, ``bitrate`` and the
    settings of the interface)."""

    def __init__(
        self,
        name: str,
        settings: dict[str, Any],
        identify: Callable[[SdoLink], str] | None = None,
        expected: str = "",
    ) -> None:
        named = name or f"can {settings.get('interface')} {settings.get('channel')}"
        super().__init__(named, identify, expected)
        self._settings = settings
        self._bus: can.BusABC | None = None

    def _connect(self) -> None:
        try:
            import can
        except ImportError as error:
            raise needs("can", error) from error
        try:
            self._bus = can.Bus(**self._settings)
        except (can.CanError, OSError, ValueError, ImportError) as error:
            raise NotConnected(
                f"{self.name} cannot be opened: {error}.",
                remedy="Check the adapter, its driver and the settings of the link.",
            ) from error

    def _disconnect(self) -> None:
        bus, self._bus = self._bus, None
        if bus is not None:
            with contextlib.suppress(Exception):  # an adapter that was unplugged
                bus.shutdown()

    @contextlib.contextmanager
    def _translate(self) -> Iterator[can.BusABC]:
        """The only place where errors of python-can for an open bus are translated."""
        import can

        if self._bus is None:
            raise LinkLost(f"{self.name} is not open.", effects="none")
        try:
            yield self._bus
        except (can.CanError, OSError) as error:
            raise LinkLost(
                f"{self.name} is gone: {error}.", remedy="Plug the adapter in, then reset the module."
            ) from error


class CanLink(_Bus):
    """Messages on a bus. Because messages of all devices arrive, ``exchange`` waits for a message for which
    ``answers`` is true.
    """

    def __init__(self, *, name: str = "", **settings: Any) -> None:
        super().__init__(name, settings)

    def exchange(
        self, question: CanMessage, answers: Callable[[CanMessage], bool], timeout_s: float = 1.0
    ) -> CanMessage:
        """Raises NotConnected (nothing was sent), LinkLost, NoReply."""
        with self._in_turn():
            while self._next(0.0) is not None:
                pass  # messages before the question are no answer to it
            deadline = time.monotonic() + timeout_s
            self._put(question)
            while (message := self._next(max(deadline - time.monotonic(), 0.0))) is not None:
                if answers(message):
                    return message
            raise NoReply(
                f"{self.name}: nothing answered {question}.",
                remedy="Check that the device is switched on, and the bus's speed and termination.",
            )

    def send(self, message: CanMessage) -> None:
        """Raises NotConnected, LinkLost."""
        with self._in_turn():
            self._put(message)

    def receive(self, timeout_s: float) -> CanMessage:
        """The next message of any device. Raises NotConnected, LinkLost, NoReply."""
        with self._in_turn():
            message = self._next(timeout_s)
            if message is None:
                raise NoReply(f"{self.name} is silent.")
            return message

    def _put(self, message: CanMessage) -> None:
        import can

        note(self.name, ">", str(message).encode())
        with self._translate() as bus:
            bus.send(
                can.Message(arbitration_id=message.id, data=message.data, is_extended_id=message.extended)
            )

    def _next(self, timeout_s: float) -> CanMessage | None:
        with self._translate() as bus:
            frame = bus.recv(timeout_s)
        if frame is None:
            return None
        message = CanMessage(frame.arbitration_id, bytes(frame.data), frame.is_extended_id)
        note(self.name, "<", str(message).encode())
        return message


class SdoLink(_Bus):
    """The object dictionary of one CANopen node: ``upload`` reads, ``download`` writes.

    An abort by the node is a DeviceError. After a failure, the link waits for ``late_s`` of silence before
    the next question, because an answer contains only index and subindex. A late answer could be mistaken for
    the next one. ``emergency`` is called with the node's error messages (EMCY). ``identify`` and ``expected``
    are as in every link.
    """

    def __init__(
        self,
        node: int,
        *,
        name: str = "",
        late_s: float = 1.0,
        emergency: Callable[[bytes], None] | None = None,
        identify: Callable[[SdoLink], str] | None = None,
        expected: str = "",
        **settings: Any,
    ) -> None:
        super().__init__(name, settings, identify, expected)
        self.node = node
        self._emergency = emergency
        self._late_s = late_s
        self._failed_at = float("-inf")
        self._network: Any = None
        self._client: Any = None

    def upload(self, index: int, subindex: int = 0, *, timeout_s: float = 1.0) -> bytes:
        """Raises NotConnected (nothing was sent), DeviceError, LinkLost, NoReply, StrayReply."""
        return bytes(self._do(lambda client: client.upload(index, subindex), index, subindex, timeout_s))

    def download(self, index: int, subindex: int, data: bytes, *, timeout_s: float = 1.0) -> None:
        """Raises NotConnected (nothing was sent), DeviceError, LinkLost, NoReply, StrayReply."""
        self._do(lambda client: client.download(index, subindex, data), index, subindex, timeout_s)

    def _do(self, work: Callable[[Any], Any], index: int, subindex: int, timeout_s: float) -> Any:
        with self._in_turn():
            time.sleep(max(self._failed_at + self._late_s - time.monotonic(), 0.0))
            self._client.RESPONSE_TIMEOUT = timeout_s
            try:
                return self._ask(work, f"object {index:04X}:{subindex:02X}")
            except (NoReply, StrayReply):
                self._failed_at = time.monotonic()
                raise

    def _ask(self, work: Callable[[Any], Any], what: str) -> Any:
        """The only place where errors of canopen are translated."""
        from canopen.sdo.exceptions import SdoAbortedError, SdoCommunicationError

        where = f"{self.name}, node {self.node}, {what}"
        self._check_receiver(effects="none")
        with self._translate():
            try:
                return work(self._client)
            except SdoAbortedError as error:
                raise DeviceError(f"{where}: {error}.", effects="none") from error
            except SdoCommunicationError as error:
                if "No SDO response" in str(error):
                    self._check_receiver()
                    raise NoReply(f"{where}: no answer.", remedy="Check that it is switched on.") from error
                raise StrayReply(f"{where}: {error}.") from error
            except Exception:
                self._check_receiver()
                raise

    def _check_receiver(self, effects: str = "unknown") -> None:
        """Raise the error of the receiving thread, which ends the connection: the adapter is gone, or an
        adapter on a serial port sent noise."""
        notifier = self._network.notifier if self._network is not None else None
        if notifier is not None and notifier.exception is not None:
            raise LinkLost(
                f"{self.name} receives nothing any more: {notifier.exception}.",
                effects=effects,
                remedy="Check the adapter and its cable, then reset the module.",
            )

    def _connect(self) -> None:
        try:
            import can
            import canopen
            from canopen.objectdictionary import ObjectDictionary
            from canopen.sdo.client import SdoClient
        except ImportError as error:
            raise needs("can", error) from error
        super()._connect()

        link = self

        class Network(canopen.Network):
            """Records sent and received messages in the transcript."""

            NOTIFIER_CYCLE = 0.1  # closing waits this long for the receiving thread

            def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:
                note(link.name, ">", str(CanMessage(can_id, bytes(data))).encode())
                super().send_message(can_id, data, remote)

            def notify(self, can_id: int, data: bytearray, timestamp: float) -> None:
                note(link.name, "<", str(CanMessage(can_id, bytes(data))).encode())
                super().notify(can_id, data, timestamp)

        class Errors(can.Listener):
            """Keeps the error of the receiving thread for the next question, and makes the thread pause until
            then."""

            def on_message_received(self, msg: can.Message) -> None:
                pass

            def on_error(self, exc: Exception) -> None:
                time.sleep(ERROR_PAUSE_S)

        self._network = Network(self._bus)
        self._network.listeners.append(Errors())
        self._network.connect()
        dictionary = ObjectDictionary()  # type: ignore[no-untyped-call]
        cobs = 0x600 + self.node, 0x580 + self.node
        self._client = SdoClient(*cobs, dictionary)  # type: ignore[no-untyped-call]
        self._client.network = self._network
        self._network.subscribe(0x580 + self.node, self._client.on_response)
        if self._emergency is not None:
            report = self._emergency
            self._network.subscribe(0x80 + self.node, lambda _, data, __: report(bytes(data)))

    def _disconnect(self) -> None:
        network, self._network = self._network, None
        if network is not None:
            with contextlib.suppress(Exception):  # an adapter that was unplugged
                network.disconnect()
            self._bus = None
        super()._disconnect()
