"""Program that reads the compressed points of a LAZ file by laspy and lazrs: python laz_program.py OUT MEMORY SECONDS.

It runs in a process of its own (`hdsp.base.separate_process`), because lazrs ends the process where a damaged file asks
for more memory than there is. Standard input is the file; the points float64 [n, 3] go to OUT,
NaN = noise, or withheld.
"""

import io
import resource
import sys


def _main() -> None:
    out, memory, seconds = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
    for kind, value in ((resource.RLIMIT_AS, memory), (resource.RLIMIT_CPU, seconds), (resource.RLIMIT_CORE, 0)):
        hard = resource.getrlimit(kind)[1]
        resource.setrlimit(kind, (value if hard == resource.RLIM_INFINITY else min(value, hard), hard))
    content = sys.stdin.buffer.read()
    try:
        import laspy
        import numpy as np

        # One reader in one thread; extended records of variable length stay unread.
        with laspy.open(io.BytesIO(content), laz_backend=laspy.LazBackend.Lazrs, read_evlrs=False) as reader:
            points = reader.read_points(reader.header.point_count)
        noise = (7, 18) if reader.header.point_format.id >= 6 else (7,)  # as in `las`
        places = np.stack([points.x, points.y, points.z], axis=1)
        places[np.isin(points.classification, noise) | (np.asarray(points.withheld) > 0)] = np.nan
        np.save(out, places, allow_pickle=False)
    except BaseException as error:  # lazrs panics with an exception beside Exception
        raise SystemExit(" ".join(f"{error}".split()) or type(error).__name__) from None


if __name__ == "__main__":
    _main()
