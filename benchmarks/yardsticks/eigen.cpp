// SRCKFB by hand with Eigen: one track after the other, all sizes fixed, one dense array for each half of a step.
//
// g++ -O3 -march=native -DNDEBUG eigen.cpp
#if __has_include(<Eigen/Dense>)
#include <Eigen/Dense>
#else
#include <eigen3/Eigen/Dense>
#endif
#include <cmath>

#include "harness.h"

namespace {

constexpr int POINTS = 2 * N;
constexpr int COURSE = 3, AZIMUTH = 1;

using State = Eigen::Matrix<double, N, 1>;
using Factor = Eigen::Matrix<double, N, N>;
using Measured = Eigen::Matrix<double, M, 1>;

double wrapped(double angle) { return angle - 2 * M_PI * std::rint(angle * (0.5 / M_PI)); }

State motion(const State &x) {
    const double half = x[4] * (DT / 2), square = half * half;
    const double ratio = square < 1e-6 ? 1 - square / 6 * (1 - square / 20) : std::sin(half) / half;
    const double way = x[2] * DT * ratio, middle = x[3] + half;
    return {x[0] + way * std::cos(middle), x[1] + way * std::sin(middle), x[2], x[3] + x[4] * DT, x[4]};
}

Measured sensor(const State &x) {
    const double azimuth = std::atan2(x[1], x[0]);
    return {std::sqrt(x[0] * x[0] + x[1] * x[1]), azimuth, x[2] * std::cos(x[3] - azimuth)};
}

// Lower L with the same L Lᵀ = Aᵀ A: R of A = Q R, transposed.
template <int rows, int columns>
Eigen::Matrix<double, columns, columns> tria(const Eigen::Matrix<double, rows, columns> &a) {
    const Eigen::HouseholderQR<Eigen::Matrix<double, rows, columns>> qr(a);
    return qr.matrixQR().template topRows<columns>().template triangularView<Eigen::Upper>().transpose();
}

// Columns `y` become what they differ from their mean, which is returned; angles are counted from the first column.
template <int size>
Eigen::Matrix<double, size, 1> centre(Eigen::Matrix<double, size, POINTS> &y, int angle) {
    const double first = y(angle, 0);
    for (int j = 0; j < POINTS; j++) y(angle, j) = wrapped(y(angle, j) - first);
    Eigen::Matrix<double, size, 1> mean = y.rowwise().mean();
    y.colwise() -= mean;
    mean[angle] = wrapped(mean[angle] + first);
    return mean;
}

void predict(State &x, Factor &s) {
    Eigen::Matrix<double, N, POINTS> y;
    for (int j = 0; j < N; j++) {
        const State away = std::sqrt(double(N)) * s.col(j);
        y.col(j) = motion(x + away);
        y.col(N + j) = motion(x - away);
    }
    x = centre<N>(y, COURSE);
    Eigen::Matrix<double, POINTS + N, N> a;
    a.topRows<POINTS>() = y.transpose() * std::sqrt(1.0 / POINTS);
    a.bottomRows<N>() = State(ROOT_Q).asDiagonal();
    s = tria<POINTS + N, N>(a);
}

// The block array [[R, E], [0, S]] with a column for each point, as it stands in textbooks (here transposed).
void correct(State &x, Factor &s, const Measured &z) {
    Eigen::Matrix<double, M, POINTS> y;
    Eigen::Matrix<double, M + POINTS, M + N> a;
    a.setZero();
    for (int j = 0; j < N; j++) {
        const State away = std::sqrt(double(N)) * s.col(j);
        y.col(j) = sensor(x + away);
        y.col(N + j) = sensor(x - away);
        a.block<1, N>(M + j, M) = away.transpose() * std::sqrt(1.0 / POINTS);
        a.block<1, N>(M + N + j, M) = -away.transpose() * std::sqrt(1.0 / POINTS);
    }
    const Measured expected = centre<M>(y, AZIMUTH);
    a.topLeftCorner<M, M>() = Measured(ROOT_R).asDiagonal();
    a.bottomLeftCorner<POINTS, M>() = y.transpose() * std::sqrt(1.0 / POINTS);
    const Eigen::Matrix<double, M + N, M + N> done = tria<M + POINTS, M + N>(a);
    Measured nu = z - expected;
    nu[AZIMUTH] = wrapped(nu[AZIMUTH]);
    done.topLeftCorner<M, M>().triangularView<Eigen::Lower>().solveInPlace(nu);
    x += done.bottomLeftCorner<N, M>() * nu;
    x[COURSE] = wrapped(x[COURSE]);
    s = done.bottomRightCorner<N, N>();
}

}  // namespace

static void filter(const double *z, double *mean, long tracks) {
    for (long track = 0; track < tracks; track++) {
        State x(MEAN);
        Factor s = State(ROOT_PRIOR).asDiagonal();
        for (int t = 0; t < STEPS; t++, z += M, mean += N) {
            predict(x, s);
            correct(x, s, Eigen::Map<const Measured>(z));
            Eigen::Map<State>{mean} = x;
        }
    }
}
