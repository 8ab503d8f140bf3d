"""Parts of shapes that come without them: closed components, cut where a cuboid fits badly, merged where one fits."""
