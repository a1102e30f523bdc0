"""The same; leaves the parameters of the estimate for a simulation."""

import json

from figaroh_user import Identification, run


class Kept(Identification):
    def verify(self, *arguments, **settings):
        chosen = self.selected
        if chosen is not None and chosen.values is not None:
            with open("parameters.json", "w", encoding="utf-8") as file:
                json.dump(dict(zip(chosen.names, map(float, chosen.values))), file)
        return super().verify(*arguments, **settings)


if __name__ == "__main__":
    run(Kept)
