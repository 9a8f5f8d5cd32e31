/* Finds the points that are near members, and evaluates the laws of their contact. */

#pragma once

#include "member_curve.h"

static inline void call(Law *law, const double *given, double *results, int values) {
  memset(results, 0, values * sizeof(double));
  law(results, 0, given, 0, 0, 0, 0);
}

/* Motions in a step that are still searched for; how many steps a search should last; least margin, relative
   to the radii; least arm at the end of a step in the direction of that at its start. */
static const double SPARE = 1.5, LASTS = 8, LEAST_MARGIN = 1e-3;

/* Pieces along which a contact point follows its nearest point in a step. */
enum { MOST_PIECES = 4 };

void fx_free_members(MemberContacts *m) {
  free(m->contact_point), free(m->near);
}

/* Positions of all degrees of freedom in a configuration. */
static double *positions(const MemberContacts *m, const double *q, double *out) {
  for (int i = 0; i < m->dofs; ++i) out[i] = m->reference[i] + q[i];
  return out;
}

static inline Two pair_of(const double *x, const int *dof) { return (Two){x[dof[0]], x[dof[1]]}; }

/* Nodes of the two pieces from `piece` on; behind an end of the member the node there, which has no weight. */
static inline int node_of(const MemberContact *c, int piece, int k) {
  int node = piece - 1 + k;
  return node < 0 ? piece : node >= c->nodes ? c->nodes - 1 : node;
}

/* Arms from a point to four nodes at positions x. */
static void arms_at(const MemberContact *c, int piece, Two point, const double *x, Two *r) {
  for (int k = 0; k < 4; ++k) r[k] = pair_of(x, c->node_dof + 2 * node_of(c, piece, k)) - point;
}

/* Differences of a vector at the nodes of a contact point and at its point. */
static inline void differences(const ContactPoint *e, const double *x, Two *r) {
  for (int k = 0; k < 4; ++k) r[k] = pair_of(x, e->dof + 2 + 2 * k) - pair_of(x, e->dof);
}

/* Largest motion of a pair of degrees of freedom, beside the mean one. */
static double largest_motion(const MemberContacts *m, const double *motion) {
  const int *end = m->moves + 2 * m->moving;
  Two mean = {0};
  double most = 0;
  for (const int *dof = m->moves; dof < end; dof += 2) mean += pair_of(motion, dof) / m->moving;
  for (const int *dof = m->moves; dof < end; dof += 2) {
    Two u = pair_of(motion, dof) - mean;
    most = larger(dot2(u, u), most);
  }
  return sqrt(most);
}

/* Adds a point where the piece about a node is nearest to it, among the pieces next to it. */
static void add_if_near(MemberContacts *m, int number, int i, const double *x, Two point, int node, double reach) {
  const MemberContact *c = m->of + number;
  const int *dof = c->node_dof + 2 * node;
  int begins = node == 0, ends = node == c->nodes - 1;
  Two arms[4], arm = pair_of(x, dof) - point;
  if (!begins && grows_at_joint(pair_of(x, dof - 2) - point, arm)) return;
  if (!ends && !grows_at_joint(arm, pair_of(x, dof + 2) - point)) return;
  if (c->apart > 0 && fabs(c->arc[i] - c->arc[node]) < c->apart) return;
  arms_at(c, node - ends, point, x, arms);
  NearPoint nearest = nearest_on(arms + ends, 0, begins, ends);
  if (!(nearest.distance < reach)) return;
  if (m->near_places == m->near_room) m->near = realloc(m->near, (m->near_room = 2 * m->near_room + 16) * sizeof(NearPlace));
  /* The last piece is the second of two. */
  m->near[m->near_places++] = (NearPlace){number, i, node - ends, nearest.place + ends, nearest.distance};
}

static double longest_piece(const MemberContact *c, const double *x) {
  double longest = 0;
  for (const int *dof = c->node_dof; dof < c->node_dof + 2 * (c->nodes - 1); dof += 2) {
    Two piece = pair_of(x, dof + 2) - pair_of(x, dof);
    longest = larger(dot2(piece, piece), longest);
  }
  return sqrt(longest);
}

/* Finds all points within a margin of their radii from a member: at each nearest place of its own. Nothing in a lost motion,
   whose margin is not finite. Where a node is far from a point, so are the next ones. */
static void search(MemberContacts *m, const double *x, double margin) {
  m->near_places = 0;
  for (int number = 0; isfinite(margin) && number < m->contacts; ++number) {
    const MemberContact *c = m->of + number;
    double longest = longest_piece(c, x), per_longest = 1 / longest;
    for (int i = 0; i < c->points; ++i) {
      Two point = pair_of(x, c->point_dof + 2 * i);
      double reach = c->number[i * c->numbers] + margin;
      for (int node = c->first_node; node < c->end_node; ++node) {
        Two arm = pair_of(x, c->node_dof + 2 * node) - point;
        double far = larger(fabs(arm[0]), fabs(arm[1])) - reach - longest / 2;
        if (far < 0) add_if_near(m, number, i, x, point, node, reach);
        else node += smaller(far * per_longest, c->nodes);
      }
    }
  }
}

static void set_pieces(const MemberContact *c, ContactPoint *t, int piece) {
  t->piece = piece, t->begins = piece == 0, t->ends = piece + 2 >= c->nodes, t->counted = 0;
  for (int k = 0; k < 4; ++k) {
    const int *dof = c->node_dof + 2 * node_of(c, piece, k);
    memcpy(t->dof + 2 + 2 * k, dof, 2 * sizeof(int)), t->dof[POSITIONS + 1 + k] = dof[0] + 2;
  }
}

static ContactPoint contact_point_at(const MemberContacts *m, const NearPlace *near) {
  const MemberContact *c = m->of + near->contact;
  ContactPoint e = {.contact = near->contact, .point = near->point};
  memcpy(e.dof, c->point_dof + 2 * near->point, 2 * sizeof(int)), e.dof[POSITIONS] = e.dof[0] + 2;
  /* Two pieces, of which the nearest point is next to their joint. */
  set_pieces(c, &e, near->piece - (near->place < 0 && near->piece > 0));
  return e;
}

/* The nearest point of a contact point at positions x, on the two pieces from `piece` on; `r` has its arms. */
static NearPoint near_from(const MemberContacts *m, const ContactPoint *e, const double *x, int piece, Two *r) {
  const MemberContact *c = m->of + e->contact;
  r[0] = pair_of(x, e->dof);
  arms_at(c, piece, r[0], x, r + 1);
  return nearest_point(r + 1, piece == 0, piece + 2 >= c->nodes);
}

/* The distance of a contact point that has left its pieces, on those along the member on which it is then. */
static double distance_beyond(const MemberContacts *m, const ContactPoint *e, const double *x) {
  NearPoint near = {.left = e->left};
  Two r[5];
  for (int k = 0, piece = e->piece; near.left && k < MOST_PIECES; ++k)
    piece += near.left, near = near_from(m, e, x, piece, r);
  return near.distance;
}

static void find_contact_points(MemberContacts *m, const double *x, double margin) {
  m->margin = margin, ++m->searches;
  memcpy(m->searched_at, x, m->dofs * sizeof(double));
  search(m, x, margin);
  m->contact_points = m->near_places;
  ROOM(m->contact_point, m->contact_points);
  for (int k = 0; k < m->contact_points; ++k) m->contact_point[k] = contact_point_at(m, m->near + k);
}

static double *number_of(const MemberContact *c, int point) { return c->number + (long)point * c->numbers; }

/* Where the internal variables, what is of places, and the numbers of a point are among what its law is given. */
static inline int internal_at(const MemberContact *c) { return 3 * c->coordinates + 2; }
static inline int stretch_in_slot(const MemberContacts *m, int slot) { return m->first_internal + SLOT_WIDTH * slot + 1; }
static inline int places_at(const MemberContact *c) { return internal_at(c) + c->internal + c->iteration_memory; }
static inline int numbers_at(const MemberContact *c) { return places_at(c) + 2; }

/* The slot of a contact point: that of a place less than two pieces away, or a free one; -1 if all are taken. */
static int slot_of(MemberContacts *m, const ContactPoint *e) {
  const MemberContact *c = m->of + e->contact;
  int first = c->first_slot + SLOTS * e->point, best = -1;
  double least = 2, place = e->piece + e->first.place + 1;
  for (int k = first; k < first + SLOTS; ++k) {
    double known = m->memory[SLOT_WIDTH * k], way = c->turn ? remainder(known - place, c->turn) : known - place;
    double away = known > 0 ? fabs(way) : 1.99;
    if (!m->has_slot[k] && away < least) best = k, least = away;
  }
  return best;
}

/* Whether the pieces of a contact point can go to one side and still have its nearest point. */
static int can_lean(double place, int direction) { return place - direction > -0.5 && place - direction < 1.5; }

/* How far from the ends of its pieces, in pieces, the nearest point should remain in a step. */
static const double SPARE_PIECE = 0.1;

/* About how far the nearest point of a contact point will move along its member in a step. */
static double motion_along(const ContactPoint *e, const double *v, double dt) {
  const double *n = e->first.weights, *slopes = e->first.slopes;
  const Two *r = (const Two *)e->start + 1;
  Two rates[4];
  differences(e, v, rates);
  double sum = dot2(weighted(n, rates), weighted(slopes, r)) + dot2(weighted(n, r), weighted(slopes, rates));
  return -e->first.per_rate * dt * sum;
}

/* Steps in which pieces change together, as the pattern of the tangent changes with them. */
static const double TOGETHER = 4;

/* To which side the pieces of a contact point go if its nearest point is to remain in them for some steps. */
static int direction_to_lean(const ContactPoint *e, double steps) {
  double there = e->first.place + steps * e->motion, far = larger(e->first.place, there), near = smaller(e->first.place, there);
  if (far > 1.5 - SPARE_PIECE && !e->ends && can_lean(e->first.place, 1)) return 1;
  return near < SPARE_PIECE - 0.5 && !e->begins && can_lean(e->first.place, -1) ? -1 : 0;
}

/* Whether a contact point has gone on along the nodes of a closed member that are there twice. */
static int is_behind_seam(const MemberContact *c, int piece) {
  return c->turn && (piece < c->first_node - 2 || piece > c->end_node);
}

/* The nearest points at the start of a step; returns whether all are still on the pieces of their contact points. */
static int place_contact_points(MemberContacts *m, const double *x, const double *v, double dt) {
  int changes = 0;
  for (ContactPoint *e = m->contact_point; e < m->contact_point + m->contact_points; ++e) {
    e->first = near_from(m, e, x, e->piece, (Two *)e->start);
    if (e->first.left || is_behind_seam(m->of + e->contact, e->piece)) return 0;
    e->motion = v ? motion_along(e, v, dt) : 0;
    /* The last step had to be repeated, or the nearest point is about to leave its pieces. */
    e->leans = e->leans ? (can_lean(e->first.place, e->leans) ? e->leans : 0) : direction_to_lean(e, 1);
    changes |= e->leans && e->counted;
  }
  for (ContactPoint *e = m->contact_point; e < m->contact_point + m->contact_points; ++e) {
    int direction = e->leans || !changes ? e->leans : direction_to_lean(e, TOGETHER);
    e->leans = 0;
    if (!direction) continue;
    set_pieces(m->of + e->contact, e, e->piece + direction);
    e->first = near_from(m, e, x, e->piece, (Two *)e->start);
  }
  return 1;
}

/* Sets the arguments of the law of a contact point that stay in the whole step. */
static void begin_contact_point(MemberContacts *m, ContactPoint *e, double t, double dt) {
  const MemberContact *c = m->of + e->contact;
  double *to = e->given + 3 * c->coordinates, *numbers = e->given + numbers_at(c);
  e->slot = c->internal ? slot_of(m, e) : -1;
  to[0] = t, to[1] = dt;
  memset(to + 2, 0, (c->internal + c->iteration_memory) * sizeof(double));
  memcpy(numbers, number_of(c, e->point), c->numbers * sizeof(double));
  if (e->slot >= 0) {
    m->has_slot[e->slot] = 1;
    memcpy(to + 2, m->memory + SLOT_WIDTH * e->slot + 1, c->internal * sizeof(double));
  } else if (c->internal) numbers[c->numbers - 2] = 0; /* no friction */
}

/* The start of a step: contact points, and what does not change in it. */
static void begin_members(MemberContacts *m, const double *q, const double *v, double t, double dt, const double *internal) {
  double step = fmax(m->step, v ? largest_motion(m, v) * fabs(dt) : 0), least = HUGE_VAL;
  for (int k = 0; k < m->contacts; ++k) least = fmin(least, m->of[k].number[0]);
  double wanted = fmax(2 * SPARE * LASTS * step, LEAST_MARGIN * least);
  const double *x = positions(m, q, m->start);
  for (int i = 0; i < m->dofs; ++i) m->product[i] = x[i] - m->searched_at[i];
  m->moved = largest_motion(m, m->product);
  if (2 * (m->moved + SPARE * step) > m->margin || !place_contact_points(m, x, v, dt)) {
    find_contact_points(m, x, wanted), m->moved = 0;
    place_contact_points(m, x, v, dt);
  }
  if (v) memcpy(m->v, v, m->dofs * sizeof(double));
  memset(m->has_slot, 0, m->slots * sizeof(int));
  if (m->slots) memcpy(m->memory, internal + m->first_internal, SLOT_WIDTH * m->slots * sizeof(double));
  for (ContactPoint *e = m->contact_point; e < m->contact_point + m->contact_points; ++e) begin_contact_point(m, e, t, dt);
}

/* Sums of vectors at the nodes with all kinds of weights. */
static inline void sums_of(double sums[SUMS][4], const Two *r, double *out) {
  for (int k = 0; k < SUMS; ++k) *(Two *)(out + 2 * k) = weighted(sums[k], r);
}

/* Sets the sums of rotations, and their increments with which couples do work. */
static void turn_contact_point(const MemberContacts *m, ContactPoint *e, const double *D, double *out) {
  memset(out, 0, TURN_SUMS * sizeof(double));
  for (int j = 0; j < 5; ++j) {
    double turn = D[e->dof[POSITIONS + j]], tangent = m->turning ? tan(turn / 2) : 0;
    e->slopes[j] = 1 + tangent * tangent, e->turns[j][0] = !j;
    for (int k = 1; k < TURN_SUMS; ++k) e->turns[j][k] = j ? e->sums[j][k - 1] : 0;
    for (int k = 0; k < TURN_SUMS; ++k) out[k] += e->turns[j][k] * (m->turning ? 2 * tangent : turn);
  }
}

/* Sets what the law of a contact point is given at an increment; returns whether there may be a force. */
static int move_contact_point(MemberContacts *m, ContactPoint *e, const double *D) {
  const MemberContact *c = m->of + e->contact;
  const Two *start = (const Two *)e->start + 1;
  Two change[4], end[4], rates[4];
  double radius = *number_of(c, e->point), widest = 0, *internal = e->given + internal_at(c);
  differences(e, D, change);
  e->closed = e->first.distance < radius, e->left = e->passed = 0;
  for (int i = 0; i < c->internal; ++i) e->closed |= internal[i] != 0;
  /* The distance changes by no more than the arms do. */
  for (int k = 0; k < 4; ++k) widest = larger(dot2(change[k], change[k]), widest);
  if (!e->closed && sqrt(widest) < e->first.distance - radius) return 0;
  for (int k = 0; k < 4; ++k) end[k] = start[k] + change[k];
  NearPoint near = nearest_point(end, e->begins, e->ends);
  e->left = near.left, e->end = near.place;
  e->passed = dot2(weighted(e->first.weights, start), weighted(near.weights, end)) < 0;
  e->closed |= near.distance < radius;
  if (!e->closed) return 0;
  double sums[SUMS][4], *place_slopes = e->given + places_at(c), *increments = e->given + c->coordinates;
  const NearPoint *first = &e->first;
  for (int k = 0; k < 4; ++k) {
    sums[0][k] = (first->weights[k] + near.weights[k]) / 2, sums[1][k] = near.weights[k] - first->weights[k];
    sums[2][k] = near.slopes[k], sums[3][k] = first->slopes[k];
  }
  sums_of(sums, start, e->given), sums_of(sums, change, increments);
  differences(e, m->v, rates);
  sums_of(sums, rates, increments + c->coordinates);
  place_slopes[0] = near.per_rate, place_slopes[1] = first->per_rate;
  for (int k = 0; k < SUMS; ++k) {
    e->sums[0][k] = 0;
    for (int j = 0; j < 4; ++j) e->sums[0][k] -= sums[k][j], e->sums[j + 1][k] = sums[k][j];
  }
  if (c->internal) turn_contact_point(m, e, D, increments + 2 * SUMS);
  return 1;
}

/* Derivatives `by` the coordinates of a law as those by an entry of a contact point, a position or a rotation. */
static inline double by_entry(const ContactPoint *e, const double *by, int entry) {
  double sum = 0;
  if (entry < POSITIONS)
    for (int k = 0; k < SUMS; ++k) sum += e->sums[entry / 2][k] * by[2 * k + entry % 2];
  else
    for (int k = 0, j = entry - POSITIONS; k < TURN_SUMS; ++k) sum += e->turns[j][k] * by[2 * SUMS + k];
  return sum;
}

/* Sums on which there are forces: there are none on the last one. */
enum { LOADED = SUMS - 1 };

/* A row of the tangent of the law of a contact point, with derivatives by its entries. */
INLINED void row_by_entries(const ContactPoint *e, const double *by, int turns, double *row) {
  for (int j = 0; j < 5; ++j) {
    Two sum = {0};
    for (int k = 0; k < LOADED; ++k) sum += e->sums[j][k] * *(const Two *)(by + 2 * k);
    *(Two *)(row + 2 * j) = sum;
  }
  for (int j = 0; turns && j < 5; ++j) {
    double sum = 0;
    for (int k = 0; k <= LOADED; ++k) sum += e->turns[j][k] * by[2 * SUMS + k];
    row[POSITIONS + j] = sum * e->slopes[j];
  }
}

/* The tangent of a contact point from that of its law; with `turns` also of couples, and by rotations. */
INLINED void tangent_of(ContactPoint *e, double K[COORDINATES][COORDINATES], int turns) {
  double half[COORDINATES][ENTRIES + 1], *row = e->tangent;
  for (int i = 0; i < 2 * LOADED; ++i) row_by_entries(e, K[i], turns, half[i]);
  for (int i = 2 * SUMS; turns && i <= 2 * SUMS + LOADED; ++i) row_by_entries(e, K[i], 1, half[i]);
  for (int i = 0; i < POSITIONS; ++i, row += ENTRIES) {
    const double *n = e->sums[i / 2], (*part)[ENTRIES + 1] = half + i % 2;
    for (int l = 0; l < (turns ? ENTRIES : POSITIONS); ++l) row[l] = n[0] * part[0][l] + n[1] * part[2][l] + n[2] * part[4][l];
  }
  for (int j = 0; turns && j < 5; ++j, row += ENTRIES) {
    const double *n = e->turns[j], (*part)[ENTRIES + 1] = half + 2 * SUMS;
    for (int l = 0; l < ENTRIES; ++l) row[l] = n[0] * part[0][l] + n[1] * part[1][l] + n[2] * part[2][l] + n[3] * part[3][l];
  }
}

HOT void make_tangent(const MemberContact *c, ContactPoint *e) {
  double K[COORDINATES][COORDINATES] = {{0}};
  for (int i = 0; i < c->entries; ++i) K[c->entry_row[i]][c->entry_column[i]] = e->results[c->coordinates + i];
  if (c->internal) tangent_of(e, K, 1); else tangent_of(e, K, 0);
}

/* Calls the law of a contact point, after `move_contact_point`. */
static void find_force(const MemberContact *c, ContactPoint *e) {
  call(c->law, e->given, e->results, c->coordinates + c->entries + c->internal + c->iteration_memory);
}

void fx_evaluate_members(MemberContacts *m, const double *D) {
  for (ContactPoint *e = m->contact_point; e < m->contact_point + m->contact_points; ++e) {
    const MemberContact *c = m->of + e->contact;
    if (!move_contact_point(m, e, D)) continue;
    find_force(c, e);
    const double *iteration_memory = e->results + c->coordinates + c->entries + c->internal;
    memcpy(e->given + internal_at(c) + c->internal, iteration_memory, c->iteration_memory * sizeof(double));
    make_tangent(c, e);
  }
}

/* Force of the law of a contact point on its point (0) or a node. */
static inline Two force_on(const ContactPoint *e, int i) {
  return (Two){by_entry(e, e->results, 2 * i), by_entry(e, e->results, 2 * i + 1)};
}

void fx_add_members(const MemberContacts *m, double *f) {
  for (const ContactPoint *e = m->contact_point; e < m->contact_point + m->contact_points; ++e)
    for (int i = 0; e->closed && i < m->of[e->contact].dofs; ++i) f[e->dof[i]] += by_entry(e, e->results, i);
}

/* The product of their tangent and x; 0 without any members. */
static const double *times_members(MemberContacts *m, const double *x) {
  if (!HAS(MEMBERS) || !m) return 0;
  memset(m->product, 0, m->dofs * sizeof(double));
  for (const ContactPoint *e = m->contact_point; e < m->contact_point + m->contact_points; ++e)
    for (int i = 0, n = m->of[e->contact].dofs; e->closed && i < n; ++i) {
      double sum = 0;
      for (int j = 0; j < n; ++j) sum += e->tangent[i * ENTRIES + j] * x[e->dof[j]];
      m->product[e->dof[i]] += sum;
    }
  return m->product;
}

int fx_check_members(MemberContacts *m, const double *D) {
  int state = MEMBERS_FINE;
  double *end = m->product;
  m->step = largest_motion(m, D);
  if (2 * (m->moved + m->step) > m->margin) return MEMBERS_MOVED; /* the next margin is by this step */
  for (int i = 0; i < m->dofs; ++i) end[i] = m->start[i] + D[i];
  for (ContactPoint *e = m->contact_point; e < m->contact_point + m->contact_points; ++e) {
    move_contact_point(m, e, D);
    if (e->passed) return MEMBERS_PASSED;
    if (!e->left) continue;
    /* It may touch beyond the pieces of its contact point as well. */
    if (!e->closed && distance_beyond(m, e, end) >= *number_of(m->of + e->contact, e->point)) continue;
    if (!can_lean(e->first.place, e->left)) return MEMBERS_SLID;
    e->leans = e->left, state = MEMBERS_MOVED;
  }
  return state;
}

/* Adds that of a point at a distance; sets its slopes, the derivatives by all that the law is given. */
static void add_energy_at(const MemberContacts *m, Energy *to, int contact, int point, double distance,
                          const double *internal, double *slopes) {
  const MemberContact *c = m->of + contact;
  double given[CONTACT_POINT_GIVEN] = {distance};
  given[3 * c->coordinates + 1] = 1;
  if (internal) memcpy(given + internal_at(c), internal, c->internal * sizeof(double));
  memcpy(given + numbers_at(c), number_of(c, point), c->numbers * sizeof(double));
  if (!to->by) {
    double energy;
    call(c->energy, given, &energy, 1), to->sum += energy;
    return;
  }
  call(to->by[contact], given, slopes, CONTACT_POINT_GIVEN);
  for (int i = 0; i < c->numbers; ++i)
    to->number_slopes[c->first_number + point * c->numbers + i] += slopes[numbers_at(c) + i];
}

/* Adds the energy of friction in slots; with `left` only of slots that no contact point has. */
static void add_energy_in_slots(const MemberContacts *m, Energy *to, const double *memory, int left) {
  double slopes[CONTACT_POINT_GIVEN];
  for (int i = 0; i < m->contacts; ++i)
    for (int k = 0; m->of[i].internal && k < SLOTS * m->of[i].points; ++k) {
      const MemberContact *c = m->of + i;
      int slot = c->first_slot + k, first = SLOT_WIDTH * slot + 1, point = k / SLOTS;
      if (memory[first] == 0 || (left && m->has_slot[slot])) continue;
      add_energy_at(m, to, i, point, 2 * *number_of(c, point) + 1, memory + first, slopes);
      for (int l = 0; to->by && l < c->internal; ++l)
        to->internal_slopes[m->first_internal + first + l] += slopes[internal_at(c) + l];
    }
}

static double lost_at_members(MemberContacts *m, const double *D) {
  Energy left = {0};
  double lost;
  add_energy_in_slots(m, &left, m->memory, 1);
  for (ContactPoint *e = m->contact_point; e < m->contact_point + m->contact_points; ++e) {
    const MemberContact *c = m->of + e->contact;
    if (!c->loss || !move_contact_point(m, e, D)) continue;
    call(c->loss, e->given, &lost, 1);
    left.sum += lost;
  }
  return left.sum;
}

/* Internal variables at the end of a step. */
static void evolve_members(MemberContacts *m, const double *D, double *internal) {
  double *memory = internal + m->first_internal;
  if (m->slots) memset(memory, 0, SLOT_WIDTH * m->slots * sizeof(double));
  for (ContactPoint *e = m->contact_point; e < m->contact_point + m->contact_points; ++e) {
    const MemberContact *c = m->of + e->contact;
    if (!c->internal || e->slot < 0 || !move_contact_point(m, e, D)) continue;
    find_force(c, e);
    memory[SLOT_WIDTH * e->slot] = e->piece + e->end + 1;
    memcpy(memory + SLOT_WIDTH * e->slot + 1, e->results + c->coordinates + c->entries, c->internal * sizeof(double));
  }
}

/* Adds the energy of a place that is near a member at positions x. */
static void add_energy(const MemberContacts *m, const NearPlace *near, const double *x, Energy *to) {
  const MemberContact *c = m->of + near->contact;
  double slopes[CONTACT_POINT_GIVEN];
  Two r[4];
  if (near->distance >= *number_of(c, near->point)) return;
  add_energy_at(m, to, near->contact, near->point, near->distance, 0, slopes);
  if (!to->by) return;
  ContactPoint e = contact_point_at(m, near);
  differences(&e, x, r);
  NearPoint nearest = nearest_point(r, e.begins, e.ends);
  Two along = slopes[0] / near->distance * weighted(nearest.weights, r);
  for (int i = 0; i < POSITIONS; ++i)
    to->q_slopes[e.dof[i]] += along[i % 2] * (i < 2 ? -1 : nearest.weights[i / 2 - 1]);
}

double fx_stored_at_members(MemberContacts *m, Energy *to, const double *q, const double *internal) {
  if (m->slots) add_energy_in_slots(m, to, internal + m->first_internal, 0);
  const double *x = positions(m, q, m->product);
  search(m, x, 0);
  for (int k = 0; k < m->near_places; ++k) add_energy(m, m->near + k, x, to);
  return to->sum;
}

/* Of each point the least gap, at most 1. */
static void member_gaps(MemberContacts *m, const double *q, double *out) {
  for (int i = 0; i < m->conditions; ++i) out[i] = 1;
  search(m, positions(m, q, m->product), 0);
  for (const NearPlace *near = m->near; near < m->near + m->near_places; ++near) {
    double *gap = out + m->of[near->contact].first_point + near->point;
    *gap = fmin(*gap, near->distance - *number_of(m->of + near->contact, near->point));
  }
}

/* Adds the forces on points to those that are recorded, of each slot x and y. */
static void record_members(const MemberContacts *m, double factor, double *out) {
  for (const ContactPoint *e = m->contact_point; e < m->contact_point + m->contact_points; ++e) {
    const MemberContact *c = m->of + e->contact;
    for (int k = 0; e->closed && k < 5; ++k) {
      int slot = k ? c->node_slot[node_of(c, e->piece, k - 1)] : c->point_slot[e->point];
      if (slot >= 0) *(Two *)(out + 2 * slot) -= factor * force_on(e, k);
    }
  }
}
