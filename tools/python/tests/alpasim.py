"""AlpaSim's own message classes, and the calls of a sensorsim server."""

from carla_driver_interface._proto import common_pb2 as common
from carla_driver_interface._proto import sensorsim_pb2 as messages


def calls(channel):
    """The calls of the service, by name."""
    service = messages.DESCRIPTOR.services_by_name["SensorsimService"]
    known = {"common.Empty": common.Empty, "common.VersionId": common.VersionId, "common.AvailableScenesReturn": common.AvailableScenesReturn}
    of = lambda message: known.get(message.full_name) or getattr(messages, message.name)
    return {
        method.name: channel.unary_unary(
            f"/{service.full_name}/{method.name}",
            request_serializer=of(method.input_type).SerializeToString,
            response_deserializer=of(method.output_type).FromString,
        )
        for method in service.methods
    }
