"""From the separating surface to solids that can be printed and fluid volumes that can be meshed."""
