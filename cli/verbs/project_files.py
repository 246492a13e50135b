"""Texts of a project that `init` writes; @NAME@ stands for a value."""

MAKEFILE = """# @NAME@, from the splat to a report; written by alula init, to be changed as you like.
SHELL := bash
.SHELLFLAGS := -eu -o pipefail -c
.DELETE_ON_ERROR:

ALULA ?= alula
VOXEL ?= @SIZE@
HULLS ?= @HULLS@
TRIALS ?= @TRIALS@
SEED ?= 0
# Distance around the map in which space is assumed to be free [m].
BEYOND := @BEYOND@
OUT := out

.PHONY: all verify plan simulate fly-rehearsal clean FORCE
all: $(OUT)/report.html
	@sed -n '/^## In short/,/^## /{/^##/d;/^$$/d;p}' $(OUT)/report.md
	@echo "report: $(CURDIR)/$(OUT)/report.html"

verify: $(OUT)/map.certificate.json
plan: $(OUT)/path.plan.npz
simulate: $(OUT)/path.run.mcap $(OUT)/pairs.run.mcap

$(OUT):
	mkdir -p $@

# The value of a variable, written only when it changes; targets that use the variable depend on this file.
$(OUT)/.values/%: FORCE
	@mkdir -p $(@D)
	@cmp -s $@ <<< '$($*)' || cat > $@ <<< '$($*)'

$(OUT)/splat.scene.npz: @SPLATS@ | $(OUT)
	$(ALULA) import-splat -f @WORDS@ -o $@ @IMPORT@

$(OUT)/metric.scene.npz: $(OUT)/splat.scene.npz
	$(ALULA) scale-align -f $< -o $@ @ALIGN@

$(OUT)/map.voxels.npz: $(OUT)/metric.scene.npz $(OUT)/.values/VOXEL
	$(ALULA) voxelize -f $< -o $@ --size $(VOXEL) @VOXELIZE@

$(OUT)/map.cover.npz: $(OUT)/map.voxels.npz $(OUT)/.values/HULLS
	$(ALULA) merge -f $< -o $@ --hulls $(HULLS)

$(OUT)/map.certificate.json: $(OUT)/map.cover.npz $(OUT)/map.voxels.npz $(OUT)/metric.scene.npz
	$(ALULA) verify -f $< --voxels $(OUT)/map.voxels.npz --scene $(OUT)/metric.scene.npz -o $@

$(OUT)/path.plan.npz: $(OUT)/map.cover.npz
	$(ALULA) plan -f $< -o $@ --start @START@ --goal @GOAL@ --beyond-map $(BEYOND) \\
		--interface velocity --margin @MARGIN@

# The plan, flown behind a safety filter.
$(OUT)/path.run.mcap: $(OUT)/path.plan.npz $(OUT)/map.cover.npz $(OUT)/metric.scene.npz
	$(ALULA) simulate -f $< --map $(OUT)/map.cover.npz --scene $(OUT)/metric.scene.npz -o $@

# Random start-goal pairs, defined in scenario.toml.
$(OUT)/pairs.run.mcap: scenario.toml $(OUT)/map.cover.npz $(OUT)/metric.scene.npz $(OUT)/.values/TRIALS \\
  $(OUT)/.values/SEED
	$(ALULA) simulate -f $< --trials $(TRIALS) --seed $(SEED) -o $@

$(OUT)/report.html: $(OUT)/path.run.mcap $(OUT)/pairs.run.mcap $(OUT)/map.certificate.json
	$(ALULA) report -f $(OUT)/path.run.mcap $(OUT)/pairs.run.mcap -o $@ --title "@NAME@" \\
		--cover $(OUT)/map.cover.npz --scene $(OUT)/metric.scene.npz --plan $(OUT)/path.plan.npz \\
		--certificate $(OUT)/map.certificate.json

# The plan in real time, on a simulated vehicle that stands below the start.
fly-rehearsal: $(OUT)/path.plan.npz $(OUT)/map.cover.npz
	$(ALULA) fly $< --map $(OUT)/map.cover.npz --link "sim:?start=@STAND@" -f -o $(OUT)/rehearsal.run.mcap

clean:
	rm -rf $(OUT)
"""

SCENARIO = """# Random start-goal pairs through the map; alula scenario scenario.toml shows all values.
schema = "alula/scenario"
version = "2.0"
name = "@NAME@, random pairs"

[vehicle]
type = "single-integrator"
radius_m = 0.15

[world]
cover = "out/map.cover.npz"
scene = "out/metric.scene.npz"

[mission]
kind = "pairs"
planned = true                   # each along a plan of its own; straight flights slide along obstacles
beyond_map_m = @BEYOND@

[safety]
filters = ["polytope-cbf"]

[rules]
trials = @TRIALS@
"""

README = """# @NAME@

`make` takes the splat to `out/report.html`: import, metres, voxels, hulls, proof, plan, flights.

| command | does |
| --- | --- |
| `make verify` | proves that the hulls contain the ellipsoids |
| `make plan` | finds the way from start to goal |
| `make simulate` | flies the plan, and random pairs of `scenario.toml`, behind a safety filter |
| `make fly-rehearsal` | flies the plan in real time on a simulated vehicle |
| `make VOXEL=0.1 HULLS=500 TRIALS=100` | the same with other numbers |
| `make clean` | removes `out/` |

Without `alula` on the PATH: `make ALULA=/path/to/alula`.

## What alula init assumed

@ASSUMED@

Change `Makefile` and `scenario.toml` where this is wrong. Proofs hold for the map in these metres: with a
wrong scale they say nothing about the real place.
"""
