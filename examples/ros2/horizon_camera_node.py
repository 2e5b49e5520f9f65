"""A node of ROS 2 that publishes our image of every pose it hears: a client of `horizonval serve`.

It subscribes to ``pose`` (``geometry_msgs/msg/PoseStamped``: the spacecraft's body in the frame ``earth``, REP 105) and
publishes ``image_raw`` and ``camera_info`` with the stamp of the pose. Start a server and the node::

    horizonval serve --scene limb-noon-vis
    python horizon_camera_node.py

It needs ``rclpy`` and the common interfaces of a ROS 2 installation, and has not been run with one. What it puts into
the messages is made by :func:`horizonval.bridges.mcap.messages_of`, whose MCAP files are tested.
"""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from typing import Any

import rclpy
from geometry_msgs.msg import PoseStamped
from rclpy.node import Node
from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import Header

import horizonval as hv
from horizonval.bridges.mcap import EARTH_FRAME, messages_of
from horizonval.geometry.frames import inverse


class HorizonCameraNode(Node):
    """Answers each pose with an image."""

    def __init__(self) -> None:
        super().__init__("horizon_camera")
        address = self.declare_parameter("address", "").value
        self._seed = int(self.declare_parameter("seed", 0).value)
        self._client = hv.Client(address, wait_s=10.0)
        self._image = self.create_publisher(Image, "image_raw", 10)
        self._info = self.create_publisher(CameraInfo, "camera_info", 10)
        self.create_subscription(PoseStamped, "pose", self._answer, 10)

    def _answer(self, pose: PoseStamped) -> None:
        if pose.header.frame_id != EARTH_FRAME:
            self.get_logger().warning(f"a pose in the frame {pose.header.frame_id!r}, expected {EARTH_FRAME!r}")
            return
        stamp, place, turn = pose.header.stamp, pose.pose.position, pose.pose.orientation
        epoch = datetime(1970, 1, 1, tzinfo=UTC) + timedelta(seconds=stamp.sec, microseconds=stamp.nanosec / 1e3)
        try:
            served = self._client.image(
                epoch_utc=epoch,
                position_itrs_km=[place.x / 1e3, place.y / 1e3, place.z / 1e3],
                q_body_from_itrs=inverse([turn.x, turn.y, turn.z, turn.w]),
                seed=self._seed,
                truth=True,
            )
        except hv.UserError as error:
            self.get_logger().warning(str(error))
            return
        self._seed += 1
        for topic, _, content in messages_of(served.image):
            kind = topic.rpartition("/")[2]
            if kind == "image_raw":
                self._image.publish(filled(Image(), content, stamp))
            elif kind == "camera_info":
                self._info.publish(filled(CameraInfo(), content, stamp))


def filled(message: Any, content: dict[str, Any], stamp: Any) -> Any:
    """Put plain data into a message; the region of interest stays as it is by default, the whole image."""
    message.header = Header(stamp=stamp, frame_id=content["header"]["frame_id"])
    for key, value in content.items():
        if key not in ("header", "roi"):
            setattr(message, key, value)
    return message


def main() -> None:
    rclpy.init()
    node = HorizonCameraNode()
    try:
        rclpy.spin(node)
    finally:
        node.destroy_node()
        rclpy.shutdown()


if __name__ == "__main__":
    main()
