"""Reads the pictures that Tilery writes, without its code: OpenEXR scanlines of floats, ZIP."""
import hashlib
import struct
import zlib

import numpy


def _text(data, at):
    end = data.index(b"\0", at)
    return data[at:end].decode(), end + 1


def _header(data):
    """Attributes of a single-part file, and where they end."""
    assert data[:4] == b"\x76\x2f\x31\x01", "no OpenEXR file"
    assert struct.unpack_from("<I", data, 4)[0] & 0x1a00 == 0, "tiled, deep or multi-part"
    attributes, at = {}, 8
    while data[at]:
        name, at = _text(data, at)
        kind, at = _text(data, at)
        size = struct.unpack_from("<i", data, at)[0]
        attributes[name] = (kind, data[at + 4:at + 4 + size])
        at += 4 + size
    return attributes, at + 1


def _channels(value):
    names, at = [], 0
    while value[at]:
        name, at = _text(value, at)
        assert struct.unpack_from("<i", value, at)[0] == 2, "not 32-bit float"
        names.append(name)
        at += 16
    return names


def _unzip(packed, size):
    if len(packed) == size:
        return packed
    raw = numpy.frombuffer(zlib.decompress(packed), dtype=numpy.uint8)
    # The predictor stores differences plus 128; then even bytes come first, odd ones after.
    summed = numpy.cumsum(raw.astype(numpy.int64) - 128) + 128
    summed = summed.astype(numpy.uint8)
    out = numpy.empty(size, dtype=numpy.uint8)
    half = (size + 1) // 2
    out[0::2], out[1::2] = summed[:half], summed[half:]
    return out.tobytes()


def read(path):
    """(attributes, {channel: float32 array of height x width}) of the data window."""
    data = open(path, "rb").read()
    attributes, at = _header(data)
    names = _channels(attributes["channels"][1])
    x0, y0, x1, y1 = struct.unpack("<4i", attributes["dataWindow"][1])
    width, height = x1 - x0 + 1, y1 - y0 + 1
    compression = attributes["compression"][1][0]
    lines = {0: 1, 2: 1, 3: 16}[compression]
    planes = {name: numpy.empty((height, width), dtype="<f4") for name in names}
    seen = 0
    for block in range((height + lines - 1) // lines):
        offset = struct.unpack_from("<Q", data, at + 8 * block)[0]
        y, size = struct.unpack_from("<ii", data, offset)
        count = min(lines, y1 - y + 1)
        raw = _unzip(data[offset + 8:offset + 8 + size], count * width * 4 * len(names))
        rows = numpy.frombuffer(raw, dtype="<f4").reshape(count, len(names), width)
        for index, name in enumerate(names):
            planes[name][y - y0:y - y0 + count] = rows[:, index]
        seen += count
    assert seen == height, "rows are missing"
    return attributes, planes


def rgb(path):
    """height x width x 3, float32."""
    _, planes = read(path)
    return numpy.stack([planes[c] for c in "RGB"], axis=-1)


def sha256(path):
    """The hash that the report must give: RGB, float32 little-endian, row by row."""
    return hashlib.sha256(rgb(path).astype("<f4").tobytes()).hexdigest()


def write(path, pixels):
    """An uncompressed file of height x width x 3 floats, for tests of what reads pictures."""
    height, width = pixels.shape[:2]
    window = struct.pack("<4i", 0, 0, width - 1, height - 1)
    channels = b"".join(c + b"\0" + struct.pack("<iiii", 2, 0, 1, 1) for c in (b"B", b"G", b"R"))
    attributes = [("channels", "chlist", channels + b"\0"), ("compression", "compression", b"\0"),
                  ("dataWindow", "box2i", window), ("displayWindow", "box2i", window),
                  ("lineOrder", "lineOrder", b"\0"),
                  ("pixelAspectRatio", "float", struct.pack("<f", 1)),
                  ("screenWindowCenter", "v2f", struct.pack("<ff", 0, 0)),
                  ("screenWindowWidth", "float", struct.pack("<f", 1))]
    head = b"\x76\x2f\x31\x01" + struct.pack("<I", 2)
    for name, kind, value in attributes:
        head += name.encode() + b"\0" + kind.encode() + b"\0" + struct.pack("<i", len(value)) + value
    head += b"\0"
    line = 8 + 12 * width
    table = b"".join(struct.pack("<Q", len(head) + 8 * height + y * line) for y in range(height))
    rows = b"".join(struct.pack("<ii", y, 12 * width) +
                    pixels[y, :, ::-1].T.astype("<f4").tobytes() for y in range(height))
    with open(path, "wb") as file:
        file.write(head + table + rows)
