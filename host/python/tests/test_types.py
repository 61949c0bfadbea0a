"""What flankscope.pyi promises of every property is what the property gives."""

import __future__

import pathlib
import tempfile
import types
import typing
import unittest

import flankscope as fs
import numpy as np
from shapes import block, write_tool
from test_decode import frames, write_plan_and_head

STUB = pathlib.Path(__file__).parents[1] / "flankscope.pyi"


def fits(value: object, promised: typing.Any) -> bool:
    """Whether a value is of the annotated type: exactly, and down to the items and an array's dtype."""
    origin, inner = typing.get_origin(promised), typing.get_args(promised)
    if origin is typing.Literal:
        return value in inner
    if origin in (typing.Union, types.UnionType):
        return any(fits(value, one) for one in inner)
    if promised in (None, type(None)):
        return value is None
    if origin is np.ndarray:
        [item] = typing.get_args(inner[1])
        return isinstance(value, np.ndarray) and value.dtype == np.dtype(item)
    if type(value) is not (origin or promised) and not (promised is pathlib.Path and isinstance(value, pathlib.Path)):
        return False
    if origin is list:
        return all(fits(item, inner[0]) for item in value)
    if origin is tuple:
        return len(value) == len(inner) and all(map(fits, value, inner))
    if origin is dict:
        return all(fits(key, inner[0]) and fits(item, inner[1]) for key, item in value.items())
    return True


class Types(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.folder = pathlib.Path(folder.name)
        write_plan_and_head(self.folder)
        self.promised: dict[str, typing.Any] = {}
        stub = compile(STUB.read_text(), str(STUB), "exec", flags=__future__.annotations.compiler_flag)
        exec(stub, self.promised)
        self.classes = {name: of for name, of in self.promised.items() if name in fs.__all__ and isinstance(of, type)}
        # Annotations name the package's own classes.
        self.names = self.promised | vars(fs)

    def test_of_every_property(self):
        plan, head = fs.Plan(self.folder / "PLAN.toml"), fs.Head(self.folder / "head.toml")
        decoder = fs.Decoder(plan, head)
        tool, mesh = fs.Tool(write_tool(self.folder)), fs.Mesh(*block())
        points = mesh.sample(20_000, seed=1)
        found, lost = fs.register(points, mesh), fs.register(points + 500, mesh)
        given = [plan, head, decoder, decoder.decode(frames()), tool, mesh, found, lost]
        # Of one zone without points, too: its figures are NaN.
        given += fs.wear(points, tool, registration=found) + fs.wear(points[:0], tool)
        asked = set()
        for value in given:
            kind = type(value).__name__
            for name, of in vars(self.classes[kind]).items():
                if isinstance(of, property):
                    promised = eval(of.fget.__annotations__["return"], self.names)
                    held = getattr(value, name)
                    self.assertTrue(fits(held, promised), f"{kind}.{name} is {held!r}; {promised} is promised")
                    asked.add((kind, name))
        properties = {(kind, name) for kind, of in self.classes.items() for name in vars(of) if isinstance(vars(of)[name], property)}
        self.assertEqual(asked, properties)

    def test_of_a_plans_files(self):
        (self.folder / "views").mkdir()
        names = [f"{at}.png" for at in range(8)]
        for name in names:
            (self.folder / "views" / name).touch()
        files = fs.Plan(self.folder / "PLAN.toml").files(self.folder / "views")
        self.assertTrue(fits(files, eval("list[Path]", self.names)))
        self.assertEqual(files, [self.folder / "views" / name for name in names])

    def test_another_type_does_not_fit(self):
        for value, promised in [
            (True, int),
            (1, float),
            ([1], list[float]),
            ("x", typing.Literal["y"]),
            ((1, 2), tuple[int]),
            (np.zeros(3), np.typing.NDArray[np.float32]),
            ("a", pathlib.Path),
        ]:
            self.assertFalse(fits(value, promised), (value, promised))


if __name__ == "__main__":
    unittest.main()
