"""Depth images and the camera messages that belong to them."""

from __future__ import annotations

from acquisition.errors import StreamError
from acquisition.messages.depth import CameraInfo, DepthImage
from drivers.samples import CameraIntrinsics, DepthFrame

# Far more than a reorder window holds; a stream of cameras without images must not pile up.
_MOST_REMEMBERED = 1024


class DepthPairing:
    """Remembers camera messages until the images come that need them."""

    def __init__(self) -> None:
        self._cameras: dict[int, CameraIntrinsics] = {}

    def add(self, info: CameraInfo) -> None:
        """Take a camera message; it may come before or after its image in the file."""
        self._cameras[info.t_ns] = info.camera
        if len(self._cameras) > _MOST_REMEMBERED:
            del self._cameras[min(self._cameras)]

    def frame(self, image: DepthImage) -> DepthFrame:
        """Return the image with the camera of the same time, or else the latest before it.

        Raises:
            StreamError: there is none, or it is for another image size.
        """
        camera = self._cameras.get(image.t_ns) or self._latest_before(image.t_ns)
        height, width = image.depth_mm.shape
        if (width, height) != (camera.width_px, camera.height_px):
            raise StreamError(
                f"depth image at {image.t_ns} ns is {width}x{height} px but its camera message "
                f"is for {camera.width_px}x{camera.height_px} px"
            )
        return DepthFrame(image.t_ns, image.depth_mm, camera, image.sequence)

    def _latest_before(self, t_ns: int) -> CameraIntrinsics:
        stamps = [stamp for stamp in self._cameras if stamp < t_ns]
        if not stamps:
            raise StreamError(
                f"depth image at {t_ns} ns has no camera message at or before that time; "
                "the recording needs /depth/camera_info"
            )
        return self._cameras[max(stamps)]
