# Each target sets up what it needs by itself, from python3 (3.10 or later) and pip: tools/setup says how.
.DEFAULT_GOAL := help
.PHONY: help demo test test-all test-long pythons middlewares ansible mutants wheel dist bench docs reference changelog recording animation screenshots lint alloy verify

# ROS 2 writes a log file for every process: beside the Makefile rather than in the home folder.
export ROS_LOG_DIR ?= $(CURDIR)/.ros/log

help: ## this list
	@sed -n 's/^\([a-z-]*\):.*## \(.*\)/make \1|\2/p' Makefile | awk -F'|' '{ printf "%-16s %s\n", $$1, $$2 }'

demo: ## replace a talker while a listener listens (on ROS 2 where there is one, else on the simulator)
	@tools/setup run
	@tools/in-venv midstride demo $$(tools/setup backend) $(ARGS)

test: ## the tests of every day, in at most 5 minutes on two cores (ARGS='-k name' for some of them)
	@tools/test 'not full and not long' $(ARGS)

test-all: ## all tests but the long ones, and the wheel
	@HYPOTHESIS_PROFILE=thorough MIDSTRIDE_TEST_BESIDE="tools/wheel;$$MIDSTRIDE_TEST_BESIDE" tools/test 'not long' $(ARGS)

test-long: ## the tests that take minutes each
	@HYPOTHESIS_PROFILE=long tools/test long --timeout=1800 -o faulthandler_timeout=1830 -o faulthandler_exit_on_timeout=false $(ARGS)
	@tools/in-venv python tools/mutation.py --mutants 100 --minutes 30 --at-least 70
	@tools/pythons

pythons: ## the tests that need no ROS, with each other CPython from 3.10 on that is here (ARGS='-k name')
	@tools/pythons $(ARGS)

middlewares: ## the tests that need ROS 2, with each other middleware that is installed beside the default (ARGS='-k name')
	@tools/middlewares $(ARGS)

ansible: ## install ansible-core and the collection of ansible/ into .venv-ansible, for the tests that need them
	@tools/ansible
	@echo "tools/ansible ansible-playbook … runs it from there"

mutants: ## how many small changes of the code a test notices (ARGS='--mutants 300 --seed 7')
	@tools/setup test
	@tools/in-venv python tools/mutation.py $(ARGS)

wheel: ## build the wheel, install it into an empty environment, and use it from there
	@tools/wheel

dist: ## everything of a release but its upload, into dist/ (RELEASING.md)
	@tools/dist

bench: ## every benchmark, one after another: a table each, and JSON
	@tools/setup test
	@tools/in-venv tools/bench $(ARGS)

docs: ## the documentation as a site to open from the disk: site/index.html
	@tools/setup test
	@tools/in-venv tools/docs $(ARGS)

reference: ## write the generated pages and lists of docs/ anew
	@tools/setup test
	@tools/in-venv python -m tools.reference

changelog: ## what has changed since the last version, from changes/
	@tools/setup test
	@tools/in-venv towncrier build --draft --version next

recording: ## docs/recording.svg, the animation of the README, from commands that it runs
	@tools/setup test
	@tools/in-venv python tools/record.py docs/recording.svg $(ARGS)

animation: ## docs/pictures/dashboard-swap.svg, a swap on the dashboard, for the README
	@tools/screenshots animation

screenshots: ## docs/pictures, the dashboard as its documentation shows it
	@tools/screenshots

alloy: ## fetch the Alloy Analyzer (needs Java and Maven), which `midstride verify` asks
	@tools/alloy

verify: ## every proof, and every check of the Alloy specification to scope 5 (ARGS='--scope 3' takes a minute)
	@tools/setup test
	@[ -n "$$MIDSTRIDE_ALLOY" ] || tools/alloy
	@tools/in-venv midstride prove --alloy $(ARGS)

lint: ## ruff, mypy, words, the types of the dashboard's modules, and whether the generated pages of docs/ are up to date
	@tools/setup test
	@tools/in-venv ruff check .
	@tools/in-venv ruff format --check .
	@tools/in-venv mypy src tests tools/*.py ansible/plugins/module_utils
	@tools/in-venv python -m tools.words
	@tools/in-venv python -m tools.reference --check
	@tools/check-dashboard
