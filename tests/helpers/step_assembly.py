"""A STEP assembly as CAD programs write it: products, and instances of them that are moved."""

from __future__ import annotations

import re
from pathlib import Path


class _Entities:
    """The lines of the data section, numbered."""

    def __init__(self) -> None:
        self.lines: list[str] = []
        self.number = 0

    def add(self, text: str) -> str:
        self.number += 1
        self.lines.append(f"#{self.number} = {text};")
        return f"#{self.number}"

    def take(self, body: str) -> str:
        """Entities of another file, with other numbers."""
        first = self.number
        body = re.sub(r"#(\d+)", lambda match: f"#{int(match[1]) + first}", body)
        self.number = max(map(int, re.findall(r"#(\d+) =", body)))
        self.lines.append(body)
        return body

    def axes(self, offset: tuple[float, float, float]) -> str:
        place = self.add(f"CARTESIAN_POINT('',({','.join(str(float(c)) for c in offset)}))")
        up, along = self.add("DIRECTION('',(0.,0.,1.))"), self.add("DIRECTION('',(1.,0.,0.))")
        return self.add(f"AXIS2_PLACEMENT_3D('',{place},{up},{along})")


def write(
    path: Path, shapes: dict, instances: list[tuple[str, str, tuple[float, float, float]]]
) -> Path:
    """Write products (name to OCC shape, mm) and instances (product, name of the instance,
    offset)."""
    out, parts, context, application, head = _Entities(), {}, "", "", ""
    for name, shape in shapes.items():
        shape.WriteStep(str(path))
        head, _, rest = path.read_text().replace("\n", "").partition("DATA;")
        body = re.sub(
            r"PRODUCT\('[^']*',\s*'[^']*'",
            f"PRODUCT('{name}','{name}'",
            rest.partition("ENDSEC;")[0],
        )
        body = out.take(body)
        definition = re.search(r"(#\d+) = PRODUCT_DEFINITION\(", body)[1]
        own = re.search(r"SHAPE_DEFINITION_REPRESENTATION\(#\d+,(#\d+)\)", body)[1]
        origin, context = re.search(
            rf"{own} = \w+\('[^']*',\((#\d+)[^)]*\),(#\d+)\)", body
        ).groups()
        application = re.search(r"(#\d+) = APPLICATION_CONTEXT", body)[1]
        parts[name] = definition, own, origin
    mechanical = out.add(f"PRODUCT_CONTEXT('',{application},'mechanical')")
    product = out.add(f"PRODUCT('assembly','assembly','',({mechanical}))")
    formation = out.add(f"PRODUCT_DEFINITION_FORMATION('','',{product})")
    frame = out.add(f"PRODUCT_DEFINITION_CONTEXT('part definition',{application},'design')")
    whole = out.add(f"PRODUCT_DEFINITION('design','',{formation},{frame})")
    places = [out.axes(offset) for *_, offset in instances]
    shown = out.add(
        f"SHAPE_REPRESENTATION('',({','.join([out.axes((0, 0, 0)), *places])}),{context})"
    )
    shape = out.add(f"PRODUCT_DEFINITION_SHAPE('','',{whole})")
    out.add(f"SHAPE_DEFINITION_REPRESENTATION({shape},{shown})")
    for k, ((part, name, _), place) in enumerate(zip(instances, places, strict=True)):
        definition, own, origin = parts[part]
        moved = out.add(f"ITEM_DEFINED_TRANSFORMATION('','',{origin},{place})")
        relation = out.add(
            f"( REPRESENTATION_RELATIONSHIP('','',{own},{shown}) REPRESENTATION_RELATIONSHIP_WITH_"
            f"TRANSFORMATION({moved}) SHAPE_REPRESENTATION_RELATIONSHIP() )"
        )
        use = out.add(f"NEXT_ASSEMBLY_USAGE_OCCURRENCE('{k}','{name}','',{whole},{definition},$)")
        shape = out.add(f"PRODUCT_DEFINITION_SHAPE('Placement','Placement of an item',{use})")
        out.add(f"CONTEXT_DEPENDENT_SHAPE_REPRESENTATION({relation},{shape})")
    data = "\n".join(line.replace(";#", ";\n#") for line in out.lines)
    path.write_text(f"{head}DATA;\n{data}\nENDSEC;\nEND-ISO-10303-21;\n")
    return path
