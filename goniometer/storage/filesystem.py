"""On which kind of file system a file lies, for SQLite cannot keep a database whole on one that others serve."""

import re
from pathlib import Path

MOUNTS = Path("/proc/self/mounts")
"""What is mounted where, on Linux; other systems do not say it so, and are not asked."""

_SERVED = re.compile(
    r"nfs\d*|cifs|smb\w*|ncpfs|9p|afs|coda|ceph|lustre|gpfs|beegfs|pvfs2|orangefs|glusterfs|davfs|"
    r"fuse\.(sshfs|glusterfs|ceph\w*|curlftpfs|davfs\d*|s3fs|gcsfuse|rclone|smbnetfs|nfs\w*|moosefs|mfs|juicefs)"
)
"""File systems whose files lie on another machine: their locks and their order of writes cannot be relied on."""


def served_by(file: Path, mounts: Path = MOUNTS) -> str | None:
    """Type of the network file system that `file` lies on; None for a local one. The file need not be there."""
    if not mounts.exists():
        return None
    found, deepest = None, -1
    for line in mounts.read_text().splitlines():
        _, escaped, kind, *_ = line.split(" ")
        place = Path(re.sub(r"\\([0-7]{3})", lambda code: chr(int(code[1], 8)), escaped))
        # of two that are mounted at one place the later one counts
        if file.is_relative_to(place) and len(place.parts) >= deepest:
            found, deepest = kind, len(place.parts)
    return found if found is not None and _SERVED.fullmatch(found) else None
