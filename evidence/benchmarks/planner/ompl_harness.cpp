// Runs OMPL with the sampled segment test of deltasafe.planning: the same tables and constants, read from a file.
//
// usage: ompl_harness PROBLEM PLANNER (iterations|seconds) BUDGET SEED SIMPLIFY REWIRE_FACTOR
// prints: seconds of this thread, cost of the path (inf if none)
// A search with a number of iterations runs twice, and the second run is timed, with warm caches.
#include <ompl/base/goals/GoalState.h>
#include <ompl/base/objectives/PathLengthOptimizationObjective.h>
#include <ompl/base/spaces/RealVectorStateSpace.h>
#include <ompl/geometric/PathSimplifier.h>
#include <ompl/geometric/SimpleSetup.h>
#include <ompl/geometric/planners/informedtrees/BITstar.h>
#include <ompl/geometric/planners/rrt/InformedRRTstar.h>
#include <ompl/geometric/planners/rrt/RRTstar.h>
#include <ompl/util/Console.h>
#include <ompl/util/RandomNumbers.h>

#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <ctime>
#include <fstream>
#include <memory>
#include <string>
#include <vector>

namespace ob = ompl::base;
namespace og = ompl::geometric;

constexpr int32_t BLOCK = 16;

struct Numbers {
    double lower[3], per_m, cells_per_m, unit_m, rho_max_m, delta_p_m, needed_m, floor_voxels;
    double rotation_weight, steering, goal_bias, start[4], goal[4], low[4], high[4], bins_per_rad;
    int64_t nx, ny, nz, cx, cy, cz, n_samples, columns, pool, seed, bins, words;
};

struct Problem {
    Numbers n;
    std::vector<uint8_t> certificate;
    std::vector<int32_t> unsafe;
    std::vector<float> points;
    std::vector<uint64_t> free;

    explicit Problem(const char* file) {
        std::ifstream in(file, std::ios::binary);
        in.read(reinterpret_cast<char*>(&n), sizeof n);
        certificate.resize(n.cx * n.cy * n.cz);
        unsafe.resize(n.nx * n.ny * ((n.nz + 31) / 32));
        points.resize(3 * n.columns);
        free.resize(n.bins * n.nx * n.ny * n.words);
        in.read(reinterpret_cast<char*>(certificate.data()), certificate.size());
        in.read(reinterpret_cast<char*>(unsafe.data()), unsafe.size() * sizeof(int32_t));
        in.read(reinterpret_cast<char*>(points.data()), points.size() * sizeof(float));
        in.read(reinterpret_cast<char*>(free.data()), free.size() * sizeof(uint64_t));
        if (!in) {
            std::fprintf(stderr, "the problem file is not complete\n");
            std::exit(2);
        }
    }

    static uint64_t splitmix64(uint64_t key, uint64_t counter) {
        uint64_t bits = key + counter * 0x9E3779B97F4A7C15ULL;
        bits = (bits ^ (bits >> 30)) * 0xBF58476D1CE4E5B9ULL;
        bits = (bits ^ (bits >> 27)) * 0x94D049BB133111EBULL;
        return bits ^ (bits >> 31);
    }

    static int clipped(double value, int64_t last) {
        return static_cast<int>(std::fmin(std::fmax(value, 0.0), static_cast<double>(last)));
    }

    bool certified(double x, double y, double z) const {
        const int i = clipped((x - n.lower[0]) * n.cells_per_m, n.cx - 1);
        const int j = clipped((y - n.lower[1]) * n.cells_per_m, n.cy - 1);
        const int k = clipped((z - n.lower[2]) * n.cells_per_m, n.cz - 1);
        const int steps = certificate[(i * n.cy + j) * n.cz + k];
        return steps > 0 && n.unit_m * (steps - 1.0) >= n.needed_m;
    }

    bool freeByYaw(double x, double y, double z, double yaw) const {
        if (n.bins == 0) return false;
        const int i = clipped((x - n.lower[0]) * n.per_m, n.nx - 1);
        const int j = clipped((y - n.lower[1]) * n.per_m, n.ny - 1);
        const int k = clipped((z - n.lower[2]) * n.per_m, n.nz - 1);
        const double turns = yaw * n.bins_per_rad;
        const int64_t bin = std::min<int64_t>(turns - n.bins * std::floor(turns / n.bins), n.bins - 1);
        return free[((bin * n.nx + i) * n.ny + j) * n.words + (k >> 6)] >> (k & 63) & 1;
    }

    bool samplesFree(double x, double y, double z, double yaw, uint64_t bits) const {
        const float p = bits & (1ULL << 40) ? 1 : -1, q = bits & (1ULL << 41) ? 1 : -1;
        const float c = std::cos(yaw), s = std::sin(yaw);
        const float u0 = (x - n.lower[0]) * n.per_m, v0 = (y - n.lower[1]) * n.per_m, w0 = (z - n.lower[2]) * n.per_m;
        const float last_u = n.nx - 1, last_v = n.ny - 1, last_w = n.nz - 1, floor = n.floor_voxels;
        const float a = c * p, b = s * q, e = s * p, f = c * q;
        const int32_t rows = n.ny, columns = (n.nz + 31) / 32;
        const int64_t first = bits & (n.pool - 1);
        const float *px = points.data() + first, *py = px + n.columns, *pz = py + n.columns;
        for (int64_t begin = 0; begin < n.n_samples; begin += BLOCK) {  // written so that the compiler vectorizes it
            const int32_t left = n.n_samples - begin;
            int32_t bad = 0;
            for (int32_t m = 0; m < BLOCK; ++m) {
                float u = u0 + a * px[begin + m] - b * py[begin + m];
                float v = v0 + e * px[begin + m] + f * py[begin + m];
                float w = w0 + pz[begin + m];
                const int32_t below = w < floor;
                u = u > 0 ? u : 0, v = v > 0 ? v : 0, w = w > 0 ? w : 0;
                u = u < last_u ? u : last_u, v = v < last_v ? v : last_v, w = w < last_w ? w : last_w;
                const int32_t k = w, column = static_cast<int32_t>(u) * rows + static_cast<int32_t>(v);
                bad |= ((unsafe[column * columns + (k >> 5)] >> (k & 31)) | below) & static_cast<int32_t>(m < left);
            }
            if (bad & 1) return false;
        }
        return true;
    }

    bool segmentIsSafe(const double* first, const double* second) const {
        const double *a = first, *b = second;
        for (int axis = 0; axis < 4; ++axis)
            if (first[axis] != second[axis]) {
                if (first[axis] > second[axis]) std::swap(a, b);
                break;
            }
        const double scale = 1.0 / std::sqrt(n.rotation_weight);
        const double d[4] = {b[0] - a[0], b[1] - a[1], b[2] - a[2], (b[3] - a[3]) * scale};
        const double motion = std::sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2]) + n.rho_max_m * std::fabs(d[3]);
        const int steps = static_cast<int>(std::ceil(motion / n.delta_p_m));
        const double per_step = 1.0 / std::max(steps, 1);
        uint64_t key = 0;
        bool keyed = false;
        for (int step = 0; step <= steps; ++step) {
            const double t = step * per_step;
            const double x = a[0] + t * d[0], y = a[1] + t * d[1], z = a[2] + t * d[2];
            const double yaw = a[3] * scale + t * d[3];
            if (certified(x, y, z) || freeByYaw(x, y, z, yaw)) continue;
            if (!keyed) {
                key = splitmix64(static_cast<uint64_t>(n.seed), 1);
                for (int axis = 0; axis < 4; ++axis) {
                    key = splitmix64(key ^ static_cast<uint64_t>(static_cast<int64_t>(a[axis] * 1e9)), 1);
                    key = splitmix64(key ^ static_cast<uint64_t>(static_cast<int64_t>(b[axis] * 1e9)), 1);
                }
                keyed = true;
            }
            if (!samplesFree(x, y, z, yaw, splitmix64(key, step + 1))) return false;
        }
        return true;
    }
};

static const double* values(const ob::State* state) { return state->as<ob::RealVectorStateSpace::StateType>()->values; }

class SampledMotion : public ob::MotionValidator {
  public:
    SampledMotion(const ob::SpaceInformationPtr& si, const Problem& problem) : ob::MotionValidator(si), problem_(problem) {}
    bool checkMotion(const ob::State* a, const ob::State* b) const override {
        return problem_.segmentIsSafe(values(a), values(b));
    }
    bool checkMotion(const ob::State* a, const ob::State* b, std::pair<ob::State*, double>& last) const override {
        last.second = 0.0;
        return checkMotion(a, b);
    }

  private:
    const Problem& problem_;
};

static double threadSeconds() {
    timespec now;
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &now);
    return now.tv_sec + 1e-9 * now.tv_nsec;
}

template <class Planner>
static ob::PlannerPtr tree(const ob::SpaceInformationPtr& si, const Numbers& n, double rewire) {
    auto planner = std::make_shared<Planner>(si);
    planner->setRange(n.steering);
    planner->setGoalBias(n.goal_bias);
    planner->setKNearest(true);
    if (rewire > 0) planner->setRewireFactor(rewire);
    return planner;
}

static void setPlanner(og::SimpleSetup& setup, const Numbers& n, const std::string& name, double rewire) {
    const auto si = setup.getSpaceInformation();
    if (name == "RRTstar") setup.setPlanner(tree<og::RRTstar>(si, n, rewire));
    else if (name == "InformedRRTstar") setup.setPlanner(tree<og::InformedRRTstar>(si, n, rewire));
    else if (name == "BITstar") setup.setPlanner(std::make_shared<og::BITstar>(si));
    else std::exit(2);
    setup.setup();
}

static void setProblem(og::SimpleSetup& setup, const Problem& problem) {
    const Numbers& n = problem.n;
    const auto space = setup.getStateSpace();
    ob::RealVectorBounds bounds(4);
    ob::ScopedState<ob::RealVectorStateSpace> start(space), goal(space);
    for (int axis = 0; axis < 4; ++axis) {
        const double scale = axis == 3 ? std::sqrt(n.rotation_weight) : 1.0;
        bounds.setLow(axis, n.low[axis] * scale);
        bounds.setHigh(axis, n.high[axis] * scale);
        start[axis] = n.start[axis] * scale;
        goal[axis] = n.goal[axis] * scale;
    }
    space->as<ob::RealVectorStateSpace>()->setBounds(bounds);
    const auto si = setup.getSpaceInformation();
    setup.setStateValidityChecker([&](const ob::State* s) { return problem.segmentIsSafe(values(s), values(s)); });
    si->setMotionValidator(std::make_shared<SampledMotion>(si, problem));
    setup.setStartAndGoalStates(start, goal, 1e-6);
    setup.setOptimizationObjective(std::make_shared<ob::PathLengthOptimizationObjective>(si));
}

// Shortens the path until nothing changes or the thread time reaches the deadline.
static void simplify(og::SimpleSetup& setup, og::PathGeometric& path, double deadline) {
    const ob::PlannerTerminationCondition spent([&] { return threadSeconds() >= deadline; });
    og::PathSimplifier simplifier(setup.getSpaceInformation(), setup.getGoal(), setup.getOptimizationObjective());
    while (!spent) {
        const double before = path.length();
        simplifier.simplify(path, spent);
        if (path.length() >= before * (1 - 1e-9)) break;
    }
}

int main(int count, char** words) {
    if (count != 8) return 2;
    ompl::msg::setLogLevel(ompl::msg::LOG_NONE);
    const Problem problem(words[1]);
    const std::string name = words[2];
    const bool timed = std::string(words[3]) == "seconds";
    const double budget = std::atof(words[4]), fraction = std::atof(words[6]), rewire = std::atof(words[7]);
    ompl::RNG::setSeed(std::atol(words[5]) + 1);
    og::SimpleSetup setup(std::make_shared<ob::RealVectorStateSpace>(4));
    setProblem(setup, problem);
    setPlanner(setup, problem.n, name, rewire);
    double began = threadSeconds();
    long calls = 0;
    const ob::PlannerTerminationConditionFn spent = [&] {
        return timed ? threadSeconds() - began >= budget * (1 - fraction) : calls++ >= static_cast<long>(budget);
    };
    if (!timed) {
        setup.getPlanner()->solve(ob::PlannerTerminationCondition(spent));
        setup.getProblemDefinition()->clearSolutionPaths();
        setPlanner(setup, problem.n, name, rewire);
        calls = 0;
        began = threadSeconds();
    }
    setup.getPlanner()->solve(ob::PlannerTerminationCondition(spent));
    double cost = INFINITY;
    if (setup.haveExactSolutionPath()) {
        og::PathGeometric& path = setup.getSolutionPath();
        if (fraction > 0) simplify(setup, path, began + budget);
        cost = path.length();
    }
    std::printf("%.9f %.9f\n", threadSeconds() - began, cost);
    return 0;
}
