/* Microseconds of pinocchio's derivatives on a model that was saved as text, as one line of JSON. */
#include <pinocchio/multibody.hpp>
#include <pinocchio/serialization.hpp>
#include <pinocchio/algorithm/joint-configuration.hpp>
#include <pinocchio/algorithm/rnea.hpp>
#include <pinocchio/algorithm/rnea-derivatives.hpp>
#include <pinocchio/algorithm/aba-derivatives.hpp>
#include <pinocchio/algorithm/rnea-second-order-derivatives.hpp>
#include <cstdio>
#include <ctime>

template <class F> double least(F f) {
  double best = 1e9;
  for (int r = 0; r < 100; r++) {
    timespec a, b;
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &a);
    for (int k = 0; k < 100; k++) f();
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &b);
    double s = ((b.tv_sec - a.tv_sec) + 1e-9 * (b.tv_nsec - a.tv_nsec)) / 100;
    if (s < best) best = s;
  }
  return 1e6 * best;
}

int main(int, char **argv) {
  pinocchio::Model m;
  m.loadFromText(argv[1]);
  pinocchio::Data d(m);
  m.lowerPositionLimit.setConstant(-1);
  m.upperPositionLimit.setConstant(1);
  Eigen::VectorXd q = pinocchio::randomConfiguration(m);
  Eigen::VectorXd v = Eigen::VectorXd::Random(m.nv), a = Eigen::VectorXd::Random(m.nv);
  pinocchio::Data::Tensor3x A(m.nv, m.nv, m.nv), B(A), C(A), D(A);
  A.setZero(), B.setZero(), C.setZero(), D.setZero();
  printf("{\"rnea\": %g, \"RNEA derivatives\": %g, \"ABA derivatives\": %g, \"second\": %g}\n",
         least([&] { pinocchio::rnea(m, d, q, v, a); }),
         least([&] { pinocchio::computeRNEADerivatives(m, d, q, v, a); }),
         least([&] { pinocchio::computeABADerivatives(m, d, q, v, a); }),
         least([&] { pinocchio::ComputeRNEASecondOrderDerivatives(m, d, q, v, a, A, B, C, D); }));
}
