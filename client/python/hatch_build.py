"""Builds the package: generates `moldline.v1` (messages and stubs) from the .proto files; a wheel also takes the program
`moldline` along, if the variable MOLDLINE_WHEEL_PROGRAM names it."""

import os
import sysconfig
from importlib import resources
from pathlib import Path

from grpc_tools import protoc
from hatchling.builders.hooks.plugin.interface import BuildHookInterface

#: Path of the program; without it the wheel has the client alone, for all platforms.
PROGRAM = os.environ.get("MOLDLINE_WHEEL_PROGRAM")


class Build(BuildHookInterface):
    """The .proto files are the repository's, or in a source distribution those beside this file."""

    def initialize(self, version: str, build_data: dict) -> None:
        self.generate_messages()
        if PROGRAM and self.target_name == "wheel" and version == "standard":
            build_data["shared_scripts"][PROGRAM] = Path(PROGRAM).name
            build_data["pure_python"] = False
            # Any Python of this machine's kind. On Linux auditwheel replaces the tag by that of the oldest glibc.
            platform = sysconfig.get_platform().replace("-", "_").replace(".", "_")
            build_data["tag"] = f"py3-none-{platform}"

    def generate_messages(self) -> None:
        root = Path(self.root)
        sources = next(path for path in (root / "proto", root.parents[1] / "proto") if (path / "moldline").is_dir())
        files = sorted(str(path) for path in (sources / "moldline" / "v1").glob("*.proto"))
        well_known = resources.files("grpc_tools") / "_proto"
        target = root / "src"
        arguments = [f"-I{sources}", f"-I{well_known}", f"--python_out={target}", f"--pyi_out={target}"]
        if protoc.main(["protoc", *arguments, f"--grpc_python_out={target}", *files]) != 0:
            raise RuntimeError("the .proto files do not compile; the messages above say where")
        package = target / "moldline" / "v1" / "__init__.py"
        package.write_text('"""Wire messages, generated from proto/moldline/v1."""\n')
